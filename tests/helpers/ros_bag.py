"""Small ROS 2 bags of a simulated serpentine scan, written by rosbags."""

import numpy as np
from mcap.reader import make_reader
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from helpers.raw_capture import WAVEFORM, echo, words_of

EPOCH_NS = 1_700_000_000_000_000_000
PERIOD_S, SPEED_M_PER_S, WIDTH_M, STEP_M = 0.01, 0.1, 0.12, 0.0015
DRIVER = "xwr_driver/msg/AdcFrame"
DRIVER_TEXT = "std_msgs/Header header\nuint16[] shape\nint16[] samples\n"
PARTS = "radar_msgs/msg/Parts"
PARTS_TEXT = "std_msgs/Header header\nint16[] real_data\nint16[] imag_data\n"
TARGETS = np.random.default_rng(3).uniform((0.3, -0.08, -0.06), (0.4, 0.08, 0.06), (12, 3))


def scan_path(n_rows=10, n_planes=1, *, serpentine=True):
    """Times [s], positions [m] and turns about z [rad] at the corners of the path."""
    rows = []
    at = 0.0
    for plane in range(n_planes):
        turn = plane * np.pi / 6
        for row in range(n_rows):
            ends = (-WIDTH_M / 2, WIDTH_M / 2)
            z = (row - n_rows / 2) * STEP_M
            for k, y in enumerate(ends[:: -1 if serpentine and row % 2 else 1]):
                rows += [(at, y, z, turn), (at + 0.05, y, z, turn)]
                at += 0.05 + (WIDTH_M / SPEED_M_PER_S if k == 0 else 0.1)
        at += 1.0
    times, y, z, turns = np.array(rows).T
    positions = np.stack([0 * y, y, z], axis=1)
    return times, positions, turns


def at_times(path, times):
    corners, positions, turns = path
    position = np.stack([np.interp(times, corners, positions[:, k]) for k in range(3)], axis=1)
    return position, np.interp(times, corners, turns)


def frames_of(path, *, noise=100.0, targets=TARGETS, period_s=PERIOD_S, delays_s=(0.0,)):
    """Times of the frames, and their words: one receiver, a chirp for each delay."""
    times = np.arange(path[0][0] + 0.25, path[0][-1] - 0.25, period_s)
    rng, chirps = np.random.default_rng(0), []
    for delay_s in delays_s:
        position, turns = at_times(path, times + delay_s)
        turned = Rotation.from_euler("z", turns[:, None]).apply(position)
        signal = echo(turned, turned, targets, WAVEFORM, amplitude=400.0)
        noises = np.round(noise * rng.normal(size=(*signal.shape, 2))) @ [1, 1j]
        chirps.append(signal + noises)
    return times, [words_of(frame[:, None], "iq") for frame in np.stack(chirps, axis=1)]


def write_bag(
    folder, path, frames, *, late_s=0.0, adc=DRIVER, poses="tf", storage="MCAP", compression="NONE"
):
    """Bag with frames `late_s` late, and poses at 100 Hz; its folder.

    poses: "tf apart" has two links of a chain that have no time in common.
    """
    store = get_typestore(Stores.LATEST)
    store.register(get_types_from_msg(DRIVER_TEXT, DRIVER))
    store.register(get_types_from_msg(PARTS_TEXT, PARTS))
    writer = Writer(folder, version=9, storage_plugin=StoragePlugin[storage])
    writer.set_compression(CompressionMode[compression], CompressionFormat.ZSTD)
    with writer:
        if adc:
            topic = writer.add_connection("/radar/adc", adc, typestore=store)
            for time, words in zip(*frames, strict=True):
                stamp = EPOCH_NS + round(1e9 * (time + late_s))
                message = _samples(store, adc, stamp, words)
                writer.write(topic, stamp, store.serialize_cdr(message, adc))
        if poses:
            _write_poses(writer, store, path, poses, frames[0][-1] + late_s)
    return folder


def _samples(store, kind, stamp, words):
    types = store.types
    if kind == DRIVER:
        shape = np.array([1, 64, 2], dtype=np.uint16)
        return types[kind](header=header(store, stamp, "radar"), shape=shape, samples=words)
    if kind == PARTS:
        real, imaginary = (words.view("<i2")[first::2].copy() for first in (0, 1))
        about = header(store, stamp, "radar")
        return types[kind](header=about, real_data=real, imag_data=imaginary)
    layout = types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    return types[kind](layout=layout, data=words.view("u1" if "UInt8" in kind else "<i2"))


def header(store, stamp, frame):
    time = store.types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
    return store.types["std_msgs/msg/Header"](stamp=time, frame_id=frame)


def _write_poses(writer, store, path, poses, end_s):
    types = store.types
    times = np.arange(path[0][0], min(path[0][-1], end_s + 0.3), 0.01)
    position, turns = at_times(path, times)
    vector, point = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Point"]

    def quaternion(turn):
        x, y, z, w = Rotation.from_euler("z", turn).as_quat()
        return types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w)

    def link(parent, child, stamp, position, turn):
        move = types["geometry_msgs/msg/Transform"](
            translation=vector(*map(float, position)), rotation=quaternion(turn)
        )
        return types["geometry_msgs/msg/TransformStamped"](
            header=header(store, stamp, parent), child_frame_id=child, transform=move
        )

    poses, _, apart = poses.partition(" ")
    kind = {"tf": "tf2_msgs/msg/TFMessage", "odometry": "nav_msgs/msg/Odometry"}.get(
        poses, "geometry_msgs/msg/PoseStamped"
    )
    topic = writer.add_connection("/tf" if poses == "tf" else "/radar/pose", kind, typestore=store)
    # room -> table turns, table -> radar moves; the chain is the product.
    for time, where, turn in zip(times, position, turns, strict=True):
        stamp = EPOCH_NS + round(1e9 * time)
        if poses == "tf":
            links = [
                link("room", "table", stamp, np.zeros(3), turn),
                link(
                    *("table", "arm", stamp + 10**12 * bool(apart)),
                    *([*where[:2], where[2] + 0.1], 0.0),
                ),
            ]
            message = types[kind](transforms=links)
        else:
            turned = Rotation.from_euler("z", turn).apply(where)
            pose = types["geometry_msgs/msg/Pose"](
                position=point(*map(float, turned)), orientation=quaternion(turn)
            )
            about = {"header": header(store, stamp, "room")}
            if poses == "odometry":
                pose, still = (
                    types[f"geometry_msgs/msg/{name}WithCovariance"](value, np.zeros(36))
                    for name, value in (
                        ("Pose", pose),
                        (
                            "Twist",
                            types["geometry_msgs/msg/Twist"](vector(0, 0, 0), vector(0, 0, 0)),
                        ),
                    )
                )
                about |= {"child_frame_id": "radar", "twist": still}
            message = types[kind](**about, pose=pose)
        writer.write(topic, stamp, store.serialize_cdr(message, kind))
    if poses == "tf":
        static = writer.add_connection("/tf_static", kind, typestore=store)
        message = types[kind](transforms=[link("arm", "radar", EPOCH_NS, (0, 0, -0.1), 0.0)])
        writer.write(static, EPOCH_NS, store.serialize_cdr(message, kind))


def rewritten(bag, target, **options):
    """Copy of the MCAP of a bag by the package mcap, with options of its writer."""
    with next(bag.glob("*.mcap")).open("rb") as file, target.open("wb") as out:
        writer = McapWriter(out, **options)
        writer.start(profile="ros2")
        schemas, channels = {}, {}
        for schema, channel, message in make_reader(file).iter_messages():
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(
                    schema.name, schema.encoding, schema.data
                )
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas[schema.id]
                )
            writer.add_message(
                channels[channel.id], message.log_time, message.data, message.publish_time
            )
        writer.finish()
    return target
