"""Makes networks as exporters write them, and prints their files, inputs and what onnxruntime computes, as JSON.

The networks are those that trainers of robots export: perceptrons of Stable-Baselines3, rsl_rl and Brax, with and without a
normaliser, recurrent ones, and one of each operation that the package knows.
"""

import base64
import json

import numpy as np
import onnx
import onnxruntime
from onnx import TensorProto, helper, numpy_helper

rng = np.random.default_rng(7)
CASES = []


def weights(name, *shape, scale=0.5):
    return numpy_helper.from_array((rng.standard_normal(shape) * scale).astype(np.float32), name)


def ints(name, *numbers):
    return numpy_helper.from_array(np.array(numbers, np.int64), name)


def case(name, nodes, constants, inputs, outputs, opset=18):
    """A network; an input is a shape, in which a text is a size that the file leaves open."""
    infos = [helper.make_tensor_value_info(key, TensorProto.FLOAT, shape) for key, shape in inputs.items()]
    given = {
        key: (rng.standard_normal([1 if isinstance(size, str) else size for size in shape]) * 1.5).astype(np.float32)
        for key, shape in inputs.items()
    }
    kinds = outputs if isinstance(outputs, dict) else {key: TensorProto.FLOAT for key in outputs}
    results = [helper.make_tensor_value_info(key, kind, None) for key, kind in kinds.items()]
    graph = helper.make_graph(nodes, name, infos, results, constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=9)
    file = model.SerializeToString()
    session = onnxruntime.InferenceSession(file, providers=["CPUExecutionProvider"])
    said = session.run(None, given)
    CASES.append({
        "name": name,
        "file": base64.b64encode(file).decode(),
        "inputs": {key: value.ravel().tolist() for key, value in given.items()},
        "outputs": [{"shape": list(value.shape), "data": [number if np.isfinite(number) else None for number in value.astype(float).ravel()]} for value in said],
    })


def perceptron(activation, sizes, **attributes):
    nodes, constants, last = [], [], "obs"
    for layer, (width, height) in enumerate(zip(sizes, sizes[1:])):
        constants += [weights(f"w{layer}", height, width, scale=width**-0.5), weights(f"b{layer}", height)]
        is_last = layer == len(sizes) - 2
        target = "action" if is_last else f"z{layer}"
        nodes.append(helper.make_node("Gemm", [last, f"w{layer}", f"b{layer}"], [target], transB=1))
        if not is_last:
            nodes.append(helper.make_node(activation, [target], [f"a{layer}"], **attributes))
        last = f"a{layer}"
    return nodes, constants


def perceptrons():
    nodes, constants = perceptron("Elu", [48, 256, 256, 256, 12], alpha=1.0)
    case("rsl_rl: three layers of 256", nodes, constants, {"obs": ["batch", 48]}, ["action"])
    nodes, constants = perceptron("Tanh", [17, 64, 64, 6])
    flat = helper.make_node("Flatten", ["state"], ["obs"], axis=1)
    low, high = numpy_helper.from_array(np.float32(-1), "low"), numpy_helper.from_array(np.float32(1), "high")
    nodes = [flat, *nodes, helper.make_node("Clip", ["action", "low", "high"], ["clipped"])]
    case("Stable-Baselines3", nodes, [*constants, low, high], {"state": ["n", 17]}, ["clipped"])
    # Swish, a normaliser, and mean and deviation in one output.
    constants = [weights("mean", 9), weights("std", 9), weights("w0", 9, 32), weights("b0", 32), weights("w1", 32, 6)]
    nodes = [
        helper.make_node("Sub", ["obs", "mean"], ["centred"]),
        helper.make_node("Div", ["centred", "std"], ["scaled"]),
        helper.make_node("MatMul", ["scaled", "w0"], ["m0"]),
        helper.make_node("Add", ["m0", "b0"], ["z0"]),
        helper.make_node("Sigmoid", ["z0"], ["s0"]),
        helper.make_node("Mul", ["z0", "s0"], ["a0"]),
        helper.make_node("MatMul", ["a0", "w1"], ["z1"]),
        helper.make_node("Split", ["z1"], ["location", "deviation"], axis=-1, num_outputs=2),
        helper.make_node("Tanh", ["location"], ["action"]),
    ]
    case("Brax", nodes, constants, {"obs": [1, 9]}, ["action"])
    nodes = [*nodes[:7], helper.make_node("ArgMax", ["z1"], ["choice"], axis=1, keepdims=0)]
    case("a choice", nodes, constants, {"obs": [1, 9]}, {"choice": TensorProto.INT64})


def recurrent():
    size = 32
    constants = [weights("w", 1, 4 * size, 10), weights("r", 1, 4 * size, size), weights("b", 1, 8 * size)]
    constants += [weights("wo", 4, size), ints("zero", 0), ints("one", 1)]
    nodes = [
        helper.make_node("Unsqueeze", ["obs", "zero"], ["sequence"]),
        helper.make_node("LSTM", ["sequence", "w", "r", "b", "", "h_in", "c_in"], ["y", "h_out", "c_out"], hidden_size=size),
        helper.make_node("Squeeze", ["y", "one"], ["rows"]),
        helper.make_node("Squeeze", ["rows", "zero"], ["row"]),
        helper.make_node("Gemm", ["row", "wo"], ["action"], transB=1, alpha=0.5),
    ]
    state = {"h_in": [1, 1, size], "c_in": [1, 1, size]}
    case("LSTM", nodes, constants, {"obs": [1, 10], **state}, ["action", "h_out", "c_out"])
    constants = [weights("w", 1, 3 * size, 10), weights("r", 1, 3 * size, size), weights("b", 1, 6 * size)]
    gru = helper.make_node(
        "GRU", ["obs", "w", "r", "b", "", "h_in"], ["y", "h_out"], hidden_size=size, linear_before_reset=1
    )
    case("GRU, five steps", [gru], constants, {"obs": [5, 1, 10], "h_in": [1, 1, size]}, ["y", "h_out"])


def convolutions():
    constants = [weights("w0", 8, 3, 3, 3), weights("b0", 8), weights("w1", 8, 4, 3, 1), ints("flat", 1, -1)]
    constants += [weights(name, 8) for name in ("gamma", "beta", "mean")]
    constants += [numpy_helper.from_array(np.linspace(0.5, 2, 8).astype(np.float32), "variance")]
    nodes = [
        helper.make_node("Conv", ["picture", "w0", "b0"], ["c0"], strides=[2, 1], pads=[1, 0, 1, 2]),
        helper.make_node("BatchNormalization", ["c0", "gamma", "beta", "mean", "variance"], ["n0"]),
        helper.make_node("Relu", ["n0"], ["a0"]),
        helper.make_node("Conv", ["a0", "w1"], ["c1"], group=2, dilations=[2, 1]),
        helper.make_node("Reshape", ["c1", "flat"], ["features"]),
    ]
    case("two dimensions", nodes, constants, {"picture": [1, 3, 12, 9]}, ["features"])
    constants = [weights("w", 5, 6, 4), weights("b", 5)]
    node = helper.make_node("Conv", ["history", "w", "b"], ["features"], strides=[3], pads=[1, 1])
    case("one dimension", [node], constants, {"history": [1, 6, 20]}, ["features"])


def single():
    """One operation each."""
    def one(operation, *constants, shape=(2, 3, 4), opset=18, outputs=("y",), name="", **attributes):
        node = helper.make_node(operation, ["x", *(constant.name for constant in constants)], list(outputs), **attributes)
        case(name or operation, [node], list(constants), {"x": list(shape)}, list(outputs), opset)

    for operation in (
        "Abs Neg Sign Reciprocal Floor Ceil Round Exp Sin Cos Atan Erf Tanh Sigmoid Relu LeakyRelu Elu Celu Selu Softplus "
        "Softsign HardSigmoid HardSwish Mish Softmax LogSoftmax ReduceMean ReduceSum ReduceMax ReduceMin ReduceL2 Transpose "
        "Identity"
    ).split():
        one(operation)
    one("Gelu", opset=20)
    one("Gelu", opset=20, approximate="tanh", name="Gelu by tanh")
    one("Softmax", axis=1)
    one("Softmax", opset=11, name="the old Softmax")
    for operation in ("Add", "Sub", "Mul", "Div", "Pow", "Min", "Max", "PRelu"):
        one(operation, numpy_helper.from_array(np.array([[2.0], [3.0], [0.5]], np.float32), "c"), name=f"{operation} to columns")
        one(operation, numpy_helper.from_array(np.float32(2.0), "c"), name=f"{operation} to one")
    one("Transpose", perm=[2, 0, 1])
    one("ReduceMean", ints("axes", -1), keepdims=0)
    one("ReduceMean", axes=[0, 2], opset=13, name="the old ReduceMean")
    one("LayerNormalization", weights("scale", 4), weights("bias", 4), axis=-1)
    one("Concat", weights("c", 2, 2, 4), axis=1)
    one("Gather", ints("i", 2, 0, -1), axis=1)
    one("Slice", ints("starts", 1), ints("ends", 9), ints("axes", 2), ints("steps", 2))
    one("Slice", ints("starts", -1), ints("ends", -9), ints("axes", 1), ints("steps", -1), name="Slice backwards")
    one("Split", ints("sizes", 1, 3), axis=2, outputs=("a", "b"))
    one("Expand", ints("to", 5, 2, 3, 4))
    one("Clip", min=-0.5, max=0.25, opset=10, name="the old Clip")
    one("Flatten", axis=2)
    one("MatMul", weights("c", 4, 5))
    one("MatMul", weights("c", 2, 4, 5), name="MatMul of each")
    one("MatMul", weights("c", 4), name="MatMul by a vector")
    shape = [
        helper.make_node("Shape", ["x"], ["shape"]),
        helper.make_node("Gather", ["shape", "first"], ["batch"]),
        helper.make_node("Concat", ["batch", "rest"], ["wanted"], axis=0),
        helper.make_node("Reshape", ["x", "wanted"], ["y"]),
    ]
    case("a shape that is computed", shape, [ints("first", 0), ints("rest", -1)], {"x": ["n", 3, 4]}, ["y"])
    choice = [
        helper.make_node("Greater", ["x", "zero"], ["is_positive"]),
        helper.make_node("Where", ["is_positive", "x", "other"], ["y"]),
    ]
    zero = numpy_helper.from_array(np.float32(0), "zero")
    case("Where", choice, [zero, weights("other", 4)], {"x": [3, 4]}, ["y"])
    for operation in ("Sqrt", "Log"):
        nodes = [helper.make_node("Abs", ["x"], ["a"]), helper.make_node(operation, ["a"], ["y"])]
        case(operation, nodes, [], {"x": [3, 4]}, ["y"])
    for operation in ("Less", "LessOrEqual", "Greater", "GreaterOrEqual", "Equal"):
        nodes = [
            helper.make_node("Round", ["x"], ["rounded"]),
            helper.make_node(operation, ["rounded", "zero"], ["truth"]),
            helper.make_node("Not", ["truth"], ["opposite"]),
            helper.make_node("Cast", ["opposite"], ["y"], to=TensorProto.FLOAT),
        ]
        case(operation, nodes, [zero], {"x": [30]}, ["y"])
    nodes = [
        helper.make_node("Shape", ["x"], ["shape"]),
        helper.make_node("ConstantOfShape", ["shape"], ["ones"], value=numpy_helper.from_array(np.ones(1, np.float32))),
        helper.make_node("Dropout", ["x"], ["kept"]),
        helper.make_node("Sub", ["kept", "ones"], ["y"]),
    ]
    case("ConstantOfShape and Dropout", nodes, [], {"x": [3, 4]}, ["y"])
    half = [helper.make_node("Constant", [], ["c"], value_float=0.5), helper.make_node("Mul", ["x", "c"], ["y"])]
    case("Constant", half, [], {"x": [3]}, ["y"])


perceptrons()
recurrent()
convolutions()
single()
print(json.dumps(CASES))
