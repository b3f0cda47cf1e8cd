"""Trains a policy that keeps the Darwin OP on its feet when it is pushed, and measures it.

    downbeat robots copy darwin_op_balances
    python balance.py train policies/balance.toml       # writes balance.onnx beside it
    python balance.py measure policies/balance.toml     # in how many of 20 worlds the robot stands after pushes, with and without it

It needs the package downbeat-robotics with physics and policies, and `pip install onnx`. All data is simulated.

The network takes the direction of gravity and the rates of the trunk, and moves ankles, hips and knees of both legs alike. Its numbers
are found by evolution strategies: in each generation pairs of networks, each of which lies on the two sides of the present one, are
pushed ever harder until they fall, and the present one moves towards the better ones.

Source: T. Salimans, J. Ho, X. Chen, S. Sidor, I. Sutskever, "Evolution Strategies as a Scalable Alternative to Reinforcement
Learning", arXiv 1703.03864 (2017).
"""

import argparse
import functools
import math
import multiprocessing
import pathlib
import tempfile

import downbeat as db
import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

INPUTS, HIDDEN = 6, 12
# How the joints of the policy file move together: ankle pitch, hip pitch, knee, ankle roll, hip roll.
JOINTS = np.array([
    # ankle pitch  hip pitch     knee          ankle roll  hip roll, right and left of each
    [1, -1,        0, 0,         0, 0,         0, 0,       0, 0],
    [0, 0,         1, -1,        0, 0,         0, 0,       0, 0],
    [0, 0,         0, 0,         1, -1,        0, 0,       0, 0],
    [0, 0,         0, 0,         0, 0,         1, 1,       0, 0],
    [0, 0,         0, 0,         0, 0,         0, 0,       1, 1],
], np.float32)  # fmt: skip
SIZES = [(INPUTS, HIDDEN), (HIDDEN,), (HIDDEN, len(JOINTS)), (len(JOINTS),)]

# Along x and y of the world, in which the robot faces along x.
DIRECTIONS = {"front": (1, 0), "back": (-1, 0), "left": (0, 1), "right": (0, -1)}


def save(parameters: np.ndarray, file: pathlib.Path) -> None:
    """Writes a network with these numbers."""
    parts, start = [], 0
    for shape in SIZES:
        parts.append(parameters[start : start + math.prod(shape)].reshape(shape).astype(np.float32))
        start += math.prod(shape)
    constants = [numpy_helper.from_array(part, name) for part, name in zip([*parts, JOINTS], ["w0", "b0", "w1", "b1", "joints"])]
    nodes = [
        helper.make_node("Gemm", ["obs", "w0", "b0"], ["z0"]),
        helper.make_node("Tanh", ["z0"], ["a0"]),
        helper.make_node("Gemm", ["a0", "w1", "b1"], ["z1"]),
        helper.make_node("Tanh", ["z1"], ["a1"]),
        helper.make_node("MatMul", ["a1", "joints"], ["action"]),
    ]
    ports = [("obs", INPUTS), ("action", JOINTS.shape[1])]
    obs, action = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, size]) for name, size in ports]
    graph = helper.make_graph(nodes, "balance", [obs], [action], constants)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9), file)


class World:
    """The robot in a world that differs a little from the one before, standing."""

    def __init__(self, seed: int, policy: pathlib.Path | None) -> None:
        numbers = np.random.default_rng(seed)
        factor = lambda most: float(numbers.uniform(1 - most, 1 + most))
        self.robot = db.test.Robot()
        self.robot.add(
            "simulator", "darwin_op_simulator", link="memory:darwin_op", seed=seed,
            mass=factor(0.05), friction=factor(0.25), strength=factor(0.1), latency_ms=int(numbers.integers(0, 5)),
        )  # fmt: skip
        self.robot.add("hardware", "darwin_op", port="memory:darwin_op", remap={"joint_commands": "joint_goals"})
        self.robot.add("imu_filter", "imu_filter")
        self.robot.add("gait", "gait", start=True)
        if policy is not None:
            self.robot.add("balance", "policy", file=str(policy))
        self.robot.add("mux", "joint_command_mux", sources=["balance/joint_commands", "gait/joint_commands"])
        self.robot.heard("imu/data")
        self.robot.advance("2.5s")
        self.tilts()

    def tilts(self) -> np.ndarray:
        """By how much the trunk was tilted since the last call, in rad."""
        rotations = [imu.orientation for imu in self.robot.heard("imu/data")]
        return np.array([math.acos(max(-1.0, min(1.0, 1 - 2 * (q.x * q.x + q.y * q.y)))) for q in rotations])

    def push(self, direction: str, impulse: float) -> tuple[bool, float]:
        """Pushes the trunk, in N s; returns whether the robot stands two seconds later, and its mean tilt until then."""
        x, y = DIRECTIONS[direction]
        self.robot.inject("push", header={"frame_id": "torso"}, vector={"x": x * impulse, "y": y * impulse})
        self.robot.advance("2s")
        tilts = self.tilts()
        return bool(tilts[-1] < 0.6), float(tilts.mean())


def score(parameters: np.ndarray, file: pathlib.Path, seed: int) -> float:
    """How hard the robot may be pushed until it falls, less how much it sways."""
    total = 0.0
    with tempfile.TemporaryDirectory() as folder:
        policy = pathlib.Path(folder) / file.name
        policy.write_text(file.read_text())
        save(parameters, policy.with_suffix(".onnx"))
        for direction, first, step in (("front", 0.4, 0.1), ("back", 0.7, 0.15), ("left", 0.8, 0.15)):
            world = World(seed, policy)
            for number in range(8):
                stands, tilt = world.push(direction, first + step * number)
                total += (step if stands else 0.0) - 0.3 * step * min(tilt, 1.0)
                if not stands:
                    break
    return total


def train(file: pathlib.Path, generations: int, pairs: int, workers: int) -> None:
    numbers = np.random.default_rng(1)
    count = sum(math.prod(shape) for shape in SIZES)
    parameters = np.zeros(count)
    parameters[: INPUTS * HIDDEN] = numbers.standard_normal(INPUTS * HIDDEN) * 0.7
    velocity = np.zeros(count)
    spread, rate, inertia = 0.15, 0.25, 0.7
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        for generation in range(generations):
            noise = numbers.standard_normal((pairs, count))
            candidates = [parameters + sign * spread * one for one in noise for sign in (1, -1)]
            scores = np.array(pool.map(functools.partial(score, file=file, seed=1000 + generation), candidates, chunksize=1))
            # By rank, so that one lucky network does not lead the way.
            ranks = scores.argsort().argsort() / (len(scores) - 1) - 0.5
            gradient = ((ranks[0::2] - ranks[1::2])[:, None] * noise).mean(axis=0)
            velocity = inertia * velocity + rate * gradient / max(np.linalg.norm(gradient), 1e-9) * math.sqrt(count) * spread
            parameters = parameters + velocity
            print(f"generation {generation}: scores {scores.min():.2f} to {scores.max():.2f}, mean {scores.mean():.2f}", flush=True)
            save(parameters, file.with_suffix(".onnx"))


def stands(case: tuple[int, str, float, pathlib.Path | None]) -> bool:
    seed, direction, impulse, policy = case
    return World(seed, policy).push(direction, impulse)[0]


def measure(file: pathlib.Path, workers: int) -> None:
    """In worlds in which it was not trained."""
    seeds = range(101, 121)
    pushes = [(direction, impulse) for direction in DIRECTIONS for impulse in (0.6, 0.8, 1.0, 1.2, 1.4)]
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        for direction, impulse in pushes:
            without, with_it = (
                sum(pool.map(stands, [(seed, direction, impulse, policy) for seed in seeds])) for policy in (None, file)
            )
            print(f"{direction:>5} {impulse:.1f} N s: stands in {without:2} of 20 worlds without, in {with_it:2} with the policy", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["train", "measure"])
    parser.add_argument("policy", type=lambda name: pathlib.Path(name).resolve(), help="the policy file, beside which its network is")
    parser.add_argument("--generations", type=int, default=40)
    parser.add_argument("--pairs", type=int, default=12)
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    if given.what == "train":
        train(given.policy, given.generations, given.pairs, given.workers)
    else:
        measure(given.policy, given.workers)
