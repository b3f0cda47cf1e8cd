"""Trains the network that balances a simulated Darwin OP against pushes, and counts which pushes it survives.

    pip install downbeat-robotics numpy onnx
    python train.py              # trains, and writes balance.onnx; minutes to an hour
    python train.py --evaluate   # 20 random pushes, with balance.onnx and with a network of zeros

The network has one layer. Its weights are found by an evolution strategy with a covariance matrix that is diagonal (sep-CMA-ES: Ros and
Hansen, "A simple modification in CMA-ES achieving linear time and space complexity", PPSN 2008).
"""

import argparse
import itertools
import math
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import downbeat as db
import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

HERE = Path(__file__).parent
POLICY = (HERE / "balance.toml").read_text()
# The outputs of balance.toml, each for the right and the left joint, which turn the other way round in pitch.
PITCH, ROLL = ["ank_pitch", "knee", "hip_pitch", "sho_pitch"], ["ank_roll", "hip_roll", "sho_roll"]
# Its inputs: gravity, angular velocity about x and y, the previous outputs.
GRAVITY_X, GRAVITY_Y, RATE_X, RATE_Y, PREVIOUS = 0, 1, 3, 4, 5
PARAMETERS = 4 * len(PITCH) + 3 * len(ROLL)
FALLEN = 0.9  # rad

ports = itertools.count()


def network(parameters: np.ndarray, path: Path) -> None:
    """Writes a network that is as good at pushes from the left as from the right."""
    outputs = 2 * (len(PITCH) + len(ROLL))
    weights, bias = np.zeros((PREVIOUS + outputs, outputs), np.float32), np.zeros(outputs, np.float32)
    pitch = parameters[: 4 * len(PITCH)].reshape(-1, 4)
    for output, sign in itertools.product(range(len(PITCH)), (1, -1)):
        column = 2 * output + (sign < 0)
        bias[column] = sign * pitch[output, 0]
        weights[GRAVITY_X, column] = sign * pitch[output, 1]
        weights[RATE_Y, column] = sign * pitch[output, 2]
        weights[PREVIOUS + column, column] = pitch[output, 3]
    roll = parameters[4 * len(PITCH) :].reshape(-1, 3)
    for output, side in itertools.product(range(len(ROLL)), range(2)):
        column = 2 * (len(PITCH) + output) + side
        weights[[GRAVITY_Y, RATE_X, PREVIOUS + column], column] = roll[output]
    graph = helper.make_graph(
        [helper.make_node("Gemm", ["observation", "weights", "bias"], ["sum"]), helper.make_node("Tanh", ["sum"], ["action"])],
        "balance",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, [1, len(weights)])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, [1, outputs])],
        [numpy_helper.from_array(weights, "weights"), numpy_helper.from_array(bias, "bias")],
    )
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)


def pushed(policy: Path, angle: float, impulse: float, **world: float) -> tuple[bool, float]:
    """Pushes the standing robot, with N·s in a direction (rad, 0 is forward). Returns whether it stands two seconds later,
    and its tilt then in parts of a fall, or which part of the time it lay."""
    port = f"memory:{next(ports)}"
    robot = db.test.Robot()
    robot.add("simulator", "darwin_op_simulator", link=port, ground_truth_hz=10.0, **world)
    robot.add("hardware", "darwin_op", port=port)
    robot.add("imu_filter", "imu_filter")
    robot.add("balance", "policy", file=str(policy))
    robot.advance("1.5s")
    robot.inject(
        "push", header={"frame_id": "torso"}, vector={"x": impulse * math.cos(angle), "y": impulse * math.sin(angle)}
    )
    for part in range(5):
        robot.advance("0.4s")
        q = robot.heard("ground_truth/odom")[-1].pose.pose.orientation
        tilt = math.acos(max(-1.0, min(1.0, 1 - 2 * (q.x**2 + q.y**2))))
        if tilt > FALLEN:
            return False, 1 - part / 5
    return True, tilt / FALLEN


# Pushes about as hard as a network of zeros survives, from the front to the back: degrees, and N·s.
TRIALS = {0: (0.6, 0.7, 0.8), 45: (0.75, 0.9, 1.05), 90: (1.2, 1.35, 1.5), 135: (1.0, 1.15, 1.3), 180: (0.8, 0.95, 1.1)}


def policy_of(parameters: np.ndarray, folder: str) -> Path:
    """Writes a policy with these parameters into a folder."""
    policy = Path(folder, "balance.toml")
    policy.write_text(POLICY)
    network(parameters, policy.with_suffix(".onnx"))
    return policy


def score(parameters: np.ndarray, seed: int) -> float:
    """The pushes that it survives; more if it then stands upright, less if it fell early. The direction in which it is worst
    counts four times: else it would only learn to lean."""
    with tempfile.TemporaryDirectory() as folder:
        policy = policy_of(parameters, folder)

        def points(angle: float, impulse: float) -> float:
            stands, how = pushed(policy, math.radians(angle), impulse, seed=seed)
            return 1 + 0.2 * (1 - how) if stands else -0.5 * how

        directions = [sum(points(angle, impulse) for impulse in impulses) for angle, impulses in TRIALS.items()]
    return sum(directions) + 3 * min(directions)


def train(generations: int, workers: int) -> None:
    """Writes the mean of each generation as balance.onnx."""
    random, n, size = np.random.default_rng(1), PARAMETERS, 16
    kept = size // 2
    ranks = np.log(kept + 0.5) - np.log(np.arange(1, kept + 1))
    ranks /= ranks.sum()
    mass = 1 / (ranks**2).sum()
    # The rates of the paper's section 3.
    c_step = (mass + 2) / (n + mass + 5)
    damping = 1 + c_step + 2 * max(0.0, math.sqrt((mass - 1) / (n + 1)) - 1)
    c_path = (4 + mass / n) / (n + 4 + 2 * mass / n)
    c_one = 2 / ((n + 1.3) ** 2 + mass) * (n + 2) / 3
    c_mu = min(1 - c_one, 2 * (mass - 2 + 1 / mass) / ((n + 2) ** 2 + mass) * (n + 2) / 3)
    expected = math.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n**2))

    mean, step, variance = np.zeros(n), 0.15, np.ones(n)
    variance[: 4 * len(PITCH) : 4] = 0.1  # a bias moves the stand itself
    step_path, path = np.zeros(n), np.zeros(n)
    with ProcessPoolExecutor(workers) as pool:
        for generation in range(generations):
            drawn = random.standard_normal((size, n))
            tried = mean + step * np.sqrt(variance) * drawn
            # All of a generation meet the same noise, and each generation another.
            scores = np.array(list(pool.map(score, tried, itertools.repeat(generation))))
            best = np.argsort(-scores)[:kept]
            moved = ranks @ drawn[best]
            mean = mean + step * np.sqrt(variance) * moved
            step_path = (1 - c_step) * step_path + math.sqrt(c_step * (2 - c_step) * mass) * moved
            grown = np.linalg.norm(step_path) / math.sqrt(1 - (1 - c_step) ** (2 * (generation + 1)))
            is_steady = grown < (1.4 + 2 / (n + 1)) * expected
            path = (1 - c_path) * path + is_steady * math.sqrt(c_path * (2 - c_path) * mass) * np.sqrt(variance) * moved
            of_best = ranks @ (variance * drawn[best] ** 2)
            variance = (1 - c_one - c_mu) * variance + c_one * path**2 + c_mu * of_best
            step *= math.exp(c_step / damping * (np.linalg.norm(step_path) / expected - 1))
            network(mean, HERE / "balance.onnx")
            print(f"generation {generation}: best {scores.max():.2f}, mean {scores.mean():.2f}, step {step:.3f}", flush=True)


def evaluate(pushes: int) -> None:
    """Prints which of some random pushes, in worlds with other masses and friction, are survived."""
    survived = {"zeros": 0, "balance": 0}
    with tempfile.TemporaryDirectory() as folder:
        policies = {"zeros": policy_of(np.zeros(PARAMETERS), folder), "balance": HERE / "balance.toml"}
        print("seed  direction  impulse  " + "  ".join(policies))
        for seed in range(1001, 1001 + pushes):
            random = np.random.default_rng(seed)
            angle, impulse = random.uniform(-math.pi, math.pi), random.uniform(0.6, 1.5)
            world = {"seed": seed, "mass": random.uniform(0.9, 1.1), "friction": random.uniform(0.8, 1.2)}
            results = []
            for name, policy in policies.items():
                stands, _ = pushed(policy, angle, impulse, **world)
                survived[name] += stands
                results.append("stands" if stands else "falls")
            print(f"{seed}  {math.degrees(angle):5.0f}°  {impulse:8.2f} N·s  " + "  ".join(f"{result:7}" for result in results))
    print(f"survived of {pushes}: {survived['zeros']} with zeros, {survived['balance']} with balance.onnx")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--evaluate", action="store_true", help="only count which pushes balance.onnx survives")
    parser.add_argument("--pushes", type=int, default=20)
    parser.add_argument("--generations", type=int, default=60)
    parser.add_argument("--workers", type=int, default=2, help="processes that simulate")
    arguments = parser.parse_args()
    if not arguments.evaluate:
        train(arguments.generations, arguments.workers)
    evaluate(arguments.pushes)
