"""ROS 2 messages without ROS, by the package rosbags: opened bags, and meshes as an MCAP."""

import importlib
import os
import sqlite3
import struct
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import quote

import numpy as np

from geraf2.errors import UserError
from geraf2.geometry.triangles import vertex_normals
from geraf2.io.mesh import TriangleMesh
from geraf2.io.mesh_colours import error_colours

CLOUD_TOPIC, MESH_TOPIC = "/geraf2/vertices", "/geraf2/mesh"
_FLOAT32 = 7  # of sensor_msgs/PointField
# Records of an MCAP file begin with kind and size; the last one has 20 bytes, zeros: no summary.
_MAGIC, _RECORD = b"\x89MCAP0\r\n", struct.Struct("<BQ")
_FOOTER, _DATA_END = _RECORD.pack(2, 20), 15
_MCAP_END = len(_FOOTER) + 20 + len(_MAGIC)
_COPIED_BYTES = 1 << 24
_TRIANGLE_LIST = 11  # of visualization_msgs/Marker


def ros_module(name: str) -> Any:
    """Return a module of rosbags, an extra; UserError where it is not installed."""
    try:
        return importlib.import_module(f"rosbags.{name}")
    except ImportError:
        what = "ROS 2 bags and MCAP files need rosbags"
        raise UserError(what=what, hint="pip install 'geraf2[ros]'") from None


def is_bag(path: Path) -> bool:
    """Whether a path has the name of a bag, or is the folder of one."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file()
    return path.suffix in (".mcap", ".db3", ".bag") and path.is_file()


def is_finished_bag(path: Path) -> bool:
    """Whether a bag's end was written; of a .db3 without metadata nobody knows."""
    if path.is_dir():
        return is_bag(path)
    if path.suffix != ".mcap" or path.stat().st_size < _MCAP_END:
        return False
    with path.open("rb") as file:
        file.seek(-_MCAP_END, os.SEEK_END)
        end = file.read()
    return end.startswith(_FOOTER) and end.endswith(_MAGIC)


def bag_files(path: Path) -> list[Path]:
    """Files of a bag that grows: of a folder its .mcap or .db3 files."""
    if not path.is_dir():
        return [path]
    return sorted(one for one in path.iterdir() if one.suffix in (".mcap", ".db3"))


@contextmanager
def open_bag(path: Path, *, is_cut: bool = False) -> Iterator[Any]:
    """Reader of a rosbag2 folder, .mcap or .db3; UserError for what cannot be read.

    is_cut: read what is there of a bag whose end is missing, as one that is being recorded.
    """
    highlevel, typesys = ros_module("highlevel"), ros_module("typesys")
    if path.suffix == ".bag":
        raise UserError(
            what="is a ROS 1 bag",
            where=path,
            expected="a rosbag2 folder, .mcap or .db3",
            hint=f"rosbags-convert --src {path.name} --dst {path.stem}",
        )
    # Bags of sqlite3 before ROS 2 Iron carry no definitions.
    store = typesys.get_typestore(typesys.Stores.LATEST)
    try:
        with ExitStack() as stack:
            paths = [path]
            if is_cut and not is_finished_bag(path):
                folder = Path(stack.enter_context(TemporaryDirectory()))
                paths = [_snapshot(one, folder / one.name) for one in bag_files(path)]
            yield stack.enter_context(highlevel.AnyReader(paths, default_typestore=store))
    except UserError:
        raise
    except Exception as error:  # a broken file raises errors of many kinds
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise UserError(
            what=f"cannot be read: {reason}",
            where=path,
            expected="a whole rosbag2 folder, .mcap or .db3",
            hint="'mcap recover' or 'ros2 bag reindex' mends a recording that was cut short",
        ) from None


def _snapshot(path: Path, target: Path) -> Path:
    """Consistent copy of a file that is being written, with what is whole of it."""
    if path.suffix == ".db3":
        with (
            closing(sqlite3.connect(f"file:{quote(str(path))}?mode=ro", uri=True)) as source,
            closing(sqlite3.connect(target)) as copy,
        ):
            source.backup(copy)
        return target
    with path.open("rb") as source, target.open("wb") as copy:
        n_bytes, end = path.stat().st_size, len(_MAGIC)
        source.seek(end)
        while len(head := source.read(_RECORD.size)) == _RECORD.size:
            kind, size = _RECORD.unpack(head)
            if kind in (_DATA_END, _FOOTER[0]) or source.tell() + size > n_bytes:
                break
            end = source.seek(size, os.SEEK_CUR)
        source.seek(0)
        while end > 0 and (data := source.read(min(end, _COPIED_BYTES))):
            end -= copy.write(data)
        copy.write(_FOOTER + bytes(20) + _MAGIC)
    return target


def write_mesh_mcap(mesh: TriangleMesh, path: Path) -> None:
    """Write a mesh as PointCloud2 of its vertices and Marker of its triangles, metres.

    Fields of the vertices: x, y, z, normal_x, normal_y, normal_z and, where the run has it,
    expected_error [m]. The triangles have the colours of the expected error.
    """
    rosbag2, typesys = ros_module("rosbag2"), ros_module("typesys")
    store = typesys.get_typestore(typesys.Stores.LATEST)
    messages = {CLOUD_TOPIC: _cloud(mesh, store), MESH_TOPIC: _marker(mesh, store)}
    with TemporaryDirectory(dir=path.parent) as folder:
        bag = Path(folder) / "bag"
        plugin = rosbag2.StoragePlugin.MCAP
        with rosbag2.Writer(bag, version=9, storage_plugin=plugin) as writer:
            for topic, message in messages.items():
                kind = message.__msgtype__
                connection = writer.add_connection(topic, kind, typestore=store)
                writer.write(connection, 0, store.serialize_cdr(message, kind))
        (bag / "bag.mcap").replace(path)


def _header(store: Any) -> Any:
    stamp = store.types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    return store.types["std_msgs/msg/Header"](stamp=stamp, frame_id="capture")


def _cloud(mesh: TriangleMesh, store: Any) -> Any:
    names = ["x", "y", "z", "normal_x", "normal_y", "normal_z"]
    columns = [*mesh.vertices.T, *vertex_normals(mesh.vertices, mesh.faces).T]
    if mesh.expected_error_m is not None:
        names.append("expected_error")
        columns.append(mesh.expected_error_m)
    table = np.stack(columns, axis=1).astype("<f4")
    field = store.types["sensor_msgs/msg/PointField"]
    return store.types["sensor_msgs/msg/PointCloud2"](
        header=_header(store),
        height=1,
        width=len(table),
        fields=[
            field(name=name, offset=4 * k, datatype=_FLOAT32, count=1)
            for k, name in enumerate(names)
        ],
        is_bigendian=False,
        point_step=4 * len(names),
        row_step=table.nbytes,
        data=np.frombuffer(table.tobytes(), dtype=np.uint8),
        is_dense=True,
    )


def _marker(mesh: TriangleMesh, store: Any) -> Any:
    types = store.types
    point, colour = types["geometry_msgs/msg/Point"], types["std_msgs/msg/ColorRGBA"]
    colours = error_colours(mesh.expected_error_m, len(mesh.vertices)) / 255.0
    corners = mesh.faces.reshape(-1)
    duration = types["builtin_interfaces/msg/Duration"](sec=0, nanosec=0)
    return types["visualization_msgs/msg/Marker"](
        header=_header(store),
        ns="geraf2",
        id=0,
        type=_TRIANGLE_LIST,
        action=0,
        pose=types["geometry_msgs/msg/Pose"](
            position=point(x=0.0, y=0.0, z=0.0),
            orientation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
        ),
        scale=types["geometry_msgs/msg/Vector3"](x=1.0, y=1.0, z=1.0),
        color=colour(r=1.0, g=1.0, b=1.0, a=1.0),
        lifetime=duration,
        frame_locked=False,
        points=[point(x=x, y=y, z=z) for x, y, z in mesh.vertices[corners].tolist()],
        colors=[colour(r=r, g=g, b=b, a=1.0) for r, g, b in colours[corners].tolist()],
        texture_resource="",
        texture=types["sensor_msgs/msg/CompressedImage"](
            header=_header(store), format="", data=np.zeros(0, dtype=np.uint8)
        ),
        uv_coordinates=[],
        text="",
        mesh_resource="",
        mesh_file=types["visualization_msgs/msg/MeshFile"](
            filename="", data=np.zeros(0, dtype=np.uint8)
        ),
        mesh_use_embedded_materials=False,
    )
