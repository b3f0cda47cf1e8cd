"""Methods of some message classes: pictures and point clouds as arrays."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

#: Channels and type of the encodings with names, as in sensor_msgs/image_encodings.hpp.
_ENCODINGS: dict[str, tuple[int, type[np.generic]]] = {
    "mono8": (1, np.uint8),
    "mono16": (1, np.uint16),
    "yuv422": (2, np.uint8),
    "uyvy": (2, np.uint8),
    "yuv422_yuy2": (2, np.uint8),
    "yuyv": (2, np.uint8),
    **{f"{order}{bits}": (len(order), kind) for order in ("rgb", "rgba", "bgr", "bgra") for bits, kind in ((8, np.uint8), (16, np.uint16))},
    **{
        f"bayer_{pattern}{bits}": (1, kind)
        for pattern in ("rggb", "bggr", "gbrg", "grbg")
        for bits, kind in ((8, np.uint8), (16, np.uint16))
    },
}
_GENERIC = re.compile(r"(8|16|32|64)([USF])C(\d*)")
_KINDS = {"U": "uint", "S": "int", "F": "float"}

#: The types of sensor_msgs/msg/PointField, by number.
_POINT_FIELDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


def _encoding(name: str) -> tuple[int, np.dtype[Any]]:
    if known := _ENCODINGS.get(name):
        return known[0], np.dtype(known[1])
    if generic := _GENERIC.fullmatch(name):
        bits, kind, channels = generic.groups()
        try:
            return int(channels or 1), np.dtype(f"{_KINDS[kind]}{bits}")
        except TypeError:
            pass
    raise ValueError(
        f"sensor_msgs/msg/Image: no array for the encoding {name!r}; known are rgb8, bgr8, rgba8, bgra8, mono8, mono16, "
        "bayer_rggb8 and its kind, yuv422, and 8UC1 to 64FC4"
    )


def _strided(data: Array, shape: tuple[int, ...], dtype: np.dtype[Any], strides: tuple[int, ...]) -> Array:
    array: Array = np.ndarray(shape, dtype, data, 0, strides)
    return array if array.flags.aligned else array.copy()


def image_to_numpy(self: Any) -> Array:
    """The picture as an array of the shape (height, width) or (height, width, channels), in the channel order of its encoding.

    It is a view of the message if this is possible in memory: read-only for a received message.
    Raises ``ValueError`` if the encoding has no array, or the size of the data does not match.
    """
    channels, dtype = _encoding(self.encoding)
    height, width, step, data = self.height, self.width, self.step, self.data
    row = width * channels * dtype.itemsize
    needed = step * (height - 1) + row if height and width else 0
    if step < row and height and width:
        raise ValueError(f"sensor_msgs/msg/Image: rows of {width} pixels of {self.encoding} have {row} bytes, but step is {step}")
    if len(data) < needed:
        raise ValueError(
            f"sensor_msgs/msg/Image: {width}x{height} pixels of {self.encoding} have {needed} bytes, but data has {len(data)}"
        )
    if self.is_bigendian and dtype.itemsize > 1:
        dtype = dtype.newbyteorder(">")
    pixel = channels * dtype.itemsize
    if channels == 1:
        return _strided(data, (height, width), dtype, (step, pixel))
    return _strided(data, (height, width, channels), dtype, (step, pixel, dtype.itemsize))


def image_from_numpy(cls: Any, array: Array, encoding: str | None = None, header: Any = None) -> Any:
    """A picture from an array of the shape (height, width) or (height, width, channels).

    The encoding of 8-bit arrays is by default mono8, rgb8 or rgba8, otherwise 16UC1, 32FC3 and so on.
    Raises ``ValueError`` if the array does not have the shape or the type of the encoding.
    """
    array = np.ascontiguousarray(array)
    if array.ndim not in (2, 3) or array.dtype.kind not in "uif":
        raise ValueError(f"a picture has two or three dimensions of numbers, got {array.ndim} of {array.dtype}")
    channels = 1 if array.ndim == 2 else array.shape[2]
    if encoding is None:
        letter = {"u": "U", "i": "S", "f": "F"}[array.dtype.kind]
        plain = {1: "mono8", 3: "rgb8", 4: "rgba8"}.get(channels) if array.dtype == np.uint8 else None
        encoding = plain or f"{array.dtype.itemsize * 8}{letter}C{channels}"
    if (channels, array.dtype.newbyteorder("=")) != _encoding(encoding):
        raise ValueError(f"an array of the shape {array.shape} of {array.dtype} is no picture in {encoding}")
    fields = {} if header is None else {"header": header}
    return cls(
        height=array.shape[0],
        width=array.shape[1],
        encoding=encoding,
        is_bigendian=int(array.dtype.byteorder == ">"),
        step=array.shape[1] * channels * array.dtype.itemsize,
        data=array.reshape(-1).view(np.uint8),
        **fields,
    )


def compressed_image_to_numpy(self: Any) -> Array:
    """Raises ``ValueError``: decode the data with a library of pictures."""
    raise ValueError(
        f"sensor_msgs/msg/CompressedImage: the picture is compressed ({self.format}); decode it with a library of pictures, for "
        "example numpy.array(PIL.Image.open(io.BytesIO(message.data))) or cv2.imdecode(message.data, cv2.IMREAD_COLOR)"
    )


def point_cloud_to_numpy(self: Any) -> Array:
    """The points as a structured array with the fields of the cloud, of the shape (width,) or (height, width): ``points["x"]``.

    It is a view of the message if this is possible in memory: read-only for a received message.
    Raises ``ValueError`` if a field or the size of the data is invalid.
    """
    order = ">" if self.is_bigendian else "<"
    names, formats, offsets = [], [], []
    for field in self.fields:
        if field.datatype not in _POINT_FIELDS:
            raise ValueError(f"sensor_msgs/msg/PointCloud2: field {field.name!r} has the unknown datatype {field.datatype}")
        kind = order + _POINT_FIELDS[field.datatype]
        names.append(field.name)
        formats.append(kind if field.count == 1 else (kind, (field.count,)))
        offsets.append(field.offset)
    dtype: np.dtype[Any] = np.dtype(
        {"names": names, "formats": formats, "offsets": offsets, "itemsize": self.point_step}
    )
    height, width, data = self.height, self.width, self.data
    needed = self.row_step * (height - 1) + width * self.point_step if height and width else 0
    if len(data) < needed or (height > 1 and self.row_step < width * self.point_step):
        raise ValueError(
            f"sensor_msgs/msg/PointCloud2: {width}x{height} points of {self.point_step} bytes in rows of {self.row_step} bytes do not "
            f"fit data of {len(data)} bytes"
        )
    # Views of structures need no alignment.
    points: Array = np.ndarray((height, width), dtype, data, 0, (self.row_step, self.point_step))
    return points if height != 1 else points[0]


#: By type: what is added to its class when it is created.
METHODS: dict[str, dict[str, Callable[..., Any] | classmethod[Any, Any, Any]]] = {
    "sensor_msgs/msg/Image": {"to_numpy": image_to_numpy, "from_numpy": classmethod(image_from_numpy)},
    "sensor_msgs/msg/CompressedImage": {"to_numpy": compressed_image_to_numpy},
    "sensor_msgs/msg/PointCloud2": {"to_numpy": point_cloud_to_numpy},
}
