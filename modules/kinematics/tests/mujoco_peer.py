"""What MuJoCo says about a model: reads {"model", "joints", "poses"} and prints mass, frames and centres of mass."""
import json
import sys

import mujoco

with open(sys.argv[2]) as file:
    asked = json.load(file)
model = mujoco.MjModel.from_xml_string(asked["model"])
data = mujoco.MjData(model)
addresses = [model.joint(name).qposadr[0] for name in asked["joints"]]
poses = []
for positions in asked["poses"]:
    for address, position in zip(addresses, positions):
        data.qpos[address] = position
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    frames = {
        model.body(body).name: [*data.xpos[body], *data.xquat[body][1:], data.xquat[body][0]]
        for body in range(1, model.nbody)
    }
    poses.append({"frames": frames, "center_of_mass": [*data.subtree_com[0]]})
# Contacts of neighbours count too.
model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_FILTERPARENT
contacts = set()
for number in range(len(asked["joints"])):
    low, high = model.joint(asked["joints"][number]).range
    child = model.joint(asked["joints"][number]).bodyid[0]
    neighbours = {child, model.body_parentid[child]}
    for step in range(101):
        data.qpos[addresses] = 0
        data.qpos[addresses[number]] = low + (high - low) * step / 100
        mujoco.mj_forward(model, data)
        for contact in data.contact:
            bodies = {int(model.geom_bodyid[geom]) for geom in (contact.geom1, contact.geom2)}
            if bodies == neighbours or data.qpos[addresses[number]] == 0:
                contacts.add(" and ".join(sorted(model.body(body).name for body in bodies)))
print(json.dumps({"mass": float(sum(model.body_mass)), "poses": poses, "contacts": sorted(contacts)}))
