"""Reads a data set of LeRobot with pyarrow: whether its files have the columns and types that its description promises, and
whether statistics and indices are right.

Usage: read_dataset.py DATASET. Prints what is in it; any contradiction raises.
"""

import json
import struct
import sys
from pathlib import Path

import numpy
import pyarrow
import pyarrow.parquet

folder = Path(sys.argv[1])
info = json.loads((folder / "meta/info.json").read_text())
statistics = json.loads((folder / "meta/stats.json").read_text())
assert info["codebase_version"] == "v3.0"
assert statistics.keys() == info["features"].keys()

data = pyarrow.concat_tables(pyarrow.parquet.read_table(path) for path in sorted(folder.glob("data/*/*.parquet")))
assert set(data.column_names) == set(info["features"])
assert data.num_rows == info["total_frames"]
arrays = {}
for name, feature in info["features"].items():
    kind, column = data.schema.field(name).type, data.column(name)
    assert column.null_count == 0, name
    if feature["dtype"] == "image":
        assert kind.field("bytes").type == pyarrow.binary() and kind.field("path").type == pyarrow.string(), kind
        height, width, _ = feature["shape"]
        for picture in column.to_pylist():
            if picture["bytes"].startswith(b"\x89PNG"):
                assert struct.unpack(">II", picture["bytes"][16:24]) == (width, height)
            else:
                assert picture["bytes"].startswith(b"\xff\xd8")
        continue
    number = pyarrow.from_numpy_dtype(feature["dtype"])
    if feature["shape"] == [1]:
        assert kind == number, (name, kind)
    else:
        assert kind.value_type == number, (name, kind)
        assert feature["names"] is None or len(feature["names"]) == feature["shape"][0]
    values = numpy.array(column.to_pylist(), dtype=feature["dtype"]).reshape(data.num_rows, -1)
    assert list(values.shape[1:]) == feature["shape"], name
    arrays[name] = values
    known = statistics[name]
    numpy.testing.assert_allclose(known["mean"], values.mean(axis=0, dtype=float), rtol=1e-5, atol=1e-7)
    numpy.testing.assert_allclose(known["std"], values.std(axis=0, dtype=float), rtol=1e-4, atol=1e-6)
    assert numpy.array_equal(numpy.float32(known["min"]), numpy.float32(values.min(axis=0))), name
    assert numpy.array_equal(numpy.float32(known["max"]), numpy.float32(values.max(axis=0))), name
    assert known["count"] == [data.num_rows]

assert (arrays["index"][:, 0] == numpy.arange(data.num_rows)).all()
times = (arrays["frame_index"][:, 0] / info["fps"]).astype("float32")
assert (arrays["timestamp"][:, 0] == times).all()

tasks = pyarrow.parquet.read_table(folder / "meta/tasks.parquet")
assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["task"]
tasks = dict(zip(tasks.column("task_index").to_pylist(), tasks.column("task").to_pylist()))
assert len(tasks) == info["total_tasks"]

episodes = []
for row in pyarrow.parquet.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pylist():
    frames = slice(row["dataset_from_index"], row["dataset_to_index"])
    assert (arrays["episode_index"][frames, 0] == row["episode_index"]).all()
    assert {tasks[number] for number in arrays["task_index"][frames, 0]} == set(row["tasks"])
    file = folder / info["data_path"].format(chunk_index=row["data/chunk_index"], file_index=row["data/file_index"])
    assert row["episode_index"] in pyarrow.parquet.read_table(file, columns=["episode_index"])["episode_index"].to_pylist()
    state = arrays["observation.state"][frames]
    numpy.testing.assert_allclose(row["stats/observation.state/mean"], state.mean(axis=0, dtype=float), rtol=1e-5, atol=1e-7)
    numpy.testing.assert_allclose(row["stats/observation.state/q90"], numpy.quantile(state, 0.9, axis=0), rtol=1e-5, atol=1e-6)
    assert row["length"] == len(state)
    episodes.append({"tasks": row["tasks"], "length": row["length"]})
assert len(episodes) == info["total_episodes"]

print(json.dumps({
    "episodes": episodes,
    "fps": info["fps"],
    "names": {name: feature["names"] for name, feature in info["features"].items()},
    "state": arrays["observation.state"].tolist(),
    "action": arrays["action"].tolist(),
    "pictures": {
        name: [len(set(picture["bytes"] for picture in data.column(name).to_pylist())), statistics[name]["mean"]]
        for name, feature in info["features"].items() if feature["dtype"] == "image"
    },
}))
