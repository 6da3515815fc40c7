"""Robot logs as other programs and robots write them."""

from datetime import UTC, datetime

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from geraf2.apps.importers._robot_log import read_log
from geraf2.apps.importers._tracks import log_track
from geraf2.errors import UserError

TIMES = 0.04 * np.arange(20)
POSITIONS = np.stack([0.3 + 0.02 * TIMES, -0.1 * TIMES, 0.05 + 0 * TIMES], axis=1)
TURN = Rotation.from_euler("xyz", [10, 20, 90], degrees=True)


def text_of(table, names, mark=",", end="", comma=False):
    def cell(value):
        return f"{value:.9f}".replace(".", ",") if comma else f"{value:.9g}"

    rows = [mark.join(map(cell, row)) + end for row in table]
    return "\n".join([names + end, *rows] if names else rows) + "\n"


def read(folder, text, encoding="utf-8"):
    (folder / "log.csv").write_text(text, encoding=encoding)
    return read_log(folder / "log.csv", keep_good=False)


PLAIN = np.column_stack([TIMES, POSITIONS])
DIALECTS = {
    "quotes": text_of(PLAIN, '"time_s","x_m","y_m","z_m"'),
    "quotes around numbers": "time_s,x_m,y_m,z_m\n"
    + "\n".join(",".join(f'"{value:.9g}"' for value in row) for row in PLAIN),
    "comma at the end": text_of(PLAIN, "time_s,x_m,y_m,z_m", end=","),
    "comma at the end of rows": text_of(PLAIN, "time_s,x_m,y_m,z_m\n#", end=",").replace(
        "time_s,x_m,y_m,z_m\n#,", "time_s,x_m,y_m,z_m"
    ),
    "comma at the end without names": text_of(PLAIN, "", end=","),
    "semicolons and decimal commas": text_of(PLAIN, "time_s;x_m;y_m;z_m", ";", comma=True),
    "the same without names": text_of(PLAIN, "", ";", comma=True),
    "the same with a mark for a spreadsheet": "sep=;\n"
    + text_of(PLAIN, "time_s;x_m;y_m;z_m", ";", comma=True),
    "tabs and decimal commas": text_of(PLAIN, "time_s\tx_m\ty_m\tz_m", "\t", comma=True),
    "spaces after commas": text_of(PLAIN, "time_s, x_m, y_m, z_m", ", "),
    "names in a comment": text_of(PLAIN, "# time_s x_m y_m z_m", " "),
    "names in a comment, other order": text_of(PLAIN[:, [1, 2, 3, 0]], "# x_m y_m z_m t", " "),
    "names of rostopic": text_of(
        PLAIN, "%time,field.pose.position.x,field.pose.position.y,field.pose.position.z"
    ),
    "a unit of its own in each column": text_of(
        PLAIN * [1e9, 1e2, 1, 1e3], "time_ns\tx_cm\ty_m\tz_mm", "\t"
    ),
    "milliseconds": text_of(PLAIN * [1e3, 1, 1, 1], "Time (ms),x,y,z"),
    "microseconds": text_of(PLAIN * [1e6, 1, 1, 1], "timestamp_us,x,y,z"),
    "other microseconds": text_of(PLAIN * [1e6, 1, 1, 1], "t [\u00b5s],x,y,z"),
    "units in brackets": text_of(PLAIN * [1, 1e3, 1e3, 1e3], "time [s],X [mm],Y [mm],Z [mm]"),
    "words": text_of(PLAIN * [1, 1e3, 1e3, 1e3], "Timestamp,PosX_mm,PosY_mm,PosZ_mm"),
    "markers of Qualisys": "NO_OF_FRAMES\t20\nMARKER_NAMES\tradar\n"
    + text_of(PLAIN * [1, 1e3, 1e3, 1e3], "Time\tradar X\tradar Y\tradar Z", "\t"),
    "of a tool": text_of(PLAIN, "t,tcp_x,tcp_y,tcp_z"),
    "of a camera": text_of(PLAIN, "timestamp,tx,ty,tz"),
    "axis first": text_of(PLAIN, "time,x_pos_m,y_pos_m,z_pos_m"),
    "of Universal Robots": text_of(
        PLAIN, "timestamp actual_TCP_pose_0 actual_TCP_pose_1 actual_TCP_pose_2", " "
    ),
}


@pytest.mark.parametrize("name", DIALECTS)
def test_every_dialect_is_read(tmp_path, name):
    encodings = {"comma": "utf-8-sig", "tabs": "utf-16"}
    encoding = next((of for word, of in encodings.items() if word in name), "utf-8")
    log = read(tmp_path, DIALECTS[name], encoding)
    assert np.allclose(log.times_s, TIMES)
    assert np.allclose(log.positions, POSITIONS)
    assert log.notes == ()


def motive(table, *, bodies=("radar",), unit="Meters", scale=1.0, marker=False):
    """Export of Motive: quaternion before position, bodies beside each other."""
    turn = ",".join(f"{value:.9f}" for value in TURN.as_quat())
    n = 8
    rows = []
    for k, (time, *at) in enumerate(table):
        place = ",".join(f"{scale * value:.9f}" for value in at)
        own = [f"{turn},{place},0.0002"] + [f"{turn},5,5,5,0.0"] * (len(bodies) - 1)
        rows.append(",".join([str(k), f"{time:.6f}", *own, *(["7,7,7"] if marker else [])]))
    spread = [body for body in bodies for _ in range(n)] + ["radar:M1"] * (3 if marker else 0)
    kinds = ["Rigid Body"] * n * len(bodies) + ["Rigid Body Marker"] * (3 if marker else 0)
    what = (["Rotation"] * 4 + ["Position"] * 3 + ["Mean Marker Error"]) * len(bodies)
    axes = ["X", "Y", "Z", "W", "X", "Y", "Z", ""] * len(bodies)
    more = ["Position"] * 3 if marker else []
    head = [
        f"Format Version,1.23,Take Name,a,Export Frame Rate,25.0,Length Units,{unit},Space,Global",
        "",
        ",".join(["", "Type", *kinds]),
        ",".join(["", "Name", *spread]),
        ",".join(["", "", *what, *more]),
        ",".join(["Frame", "Time (Seconds)", *axes, *(["X", "Y", "Z"] if marker else [])]),
    ]
    return "\n".join([*head, *rows]) + "\n"


def of_vicon(bodies=("cart",)):
    names = ",".join(["RX,RY,RZ,TX,TY,TZ"] * len(bodies))
    units = ",".join(["rad,rad,rad,mm,mm,mm"] * len(bodies))
    turn = ",".join(f"{value:.9f}" for value in TURN.as_rotvec())
    rows = [
        ",".join(
            [f"{k + 1},0"] + [",".join([turn, *(f"{1e3 * v:.6f}" for v in at)]) for _ in bodies]
        )
        for k, at in enumerate(POSITIONS)
    ]
    head = [
        "Segments",
        "25",
        ",," + ",,,,,,".join(bodies),
        f"Frame,Sub Frame,{names}",
        f",,{units}",
    ]
    return "\n".join([*head, *rows]) + "\n"


def of_qualisys(body="board"):
    table = np.column_stack([np.arange(1, 21), PLAIN * [1, 1e3, 1e3, 1e3], np.zeros((20, 4))])
    names = f"Frame\tTime\t{body} X\tY\tZ\tRoll\tPitch\tYaw\tResidual"
    head = f"NO_OF_FRAMES\t20\nFREQUENCY\t25\nDATA_INCLUDED\t6D\nBODY_NAMES\t{body}\n"
    return text_of(table, head + names, "\t")


def of_ros(names, columns):
    rows = [",".join(map(str, row)) for row in zip(*columns, strict=True)]
    return "\n".join([names, *rows]) + "\n"


NS = [round(1e9 * time) + 1_700_000_000_000_000_000 for time in TIMES]
XYZ = [[f"{value:.9f}" for value in column] for column in POSITIONS.T]
LATE = [value + 5_000_000 for value in NS]
PARTS = [[value // 10**9 for value in NS], [value % 10**9 for value in NS]]
POSE = ",".join(f"pose.position.{k}" for k in "xyz")
OF_ROS = {
    "rostopic echo -p": of_ros(
        "%time,field.header.seq,field.header.stamp,field.header.frame_id,"
        + ",".join(f"field.pose.position.{k}" for k in "xyz"),
        [LATE, range(20), NS, ["base"] * 20, *XYZ],
    ),
    "rostopic echo -p of odometry": of_ros(
        "%time,field.header.stamp,field.header.frame_id,field.child_frame_id,"
        + ",".join(f"field.pose.pose.position.{k}" for k in "xyz"),
        [LATE, NS, ["odom"] * 20, ["base"] * 20, *XYZ],
    ),
    "bagpy": of_ros(
        f"Time,header.seq,header.stamp.secs,header.stamp.nsecs,header.frame_id,{POSE}",
        [[f"{1e-9 * v:.6f}" for v in LATE], range(20), *PARTS, ["base"] * 20, *XYZ],
    ),
    "sec and nanosec": of_ros(
        f"header.stamp.sec,header.stamp.nanosec,header.frame_id,{POSE}",
        [*PARTS, ["base"] * 20, *XYZ],
    ),
    "secs and nsecs alone": of_ros(f"secs,nsecs,{POSE}", [*PARTS, *XYZ]),
    "ros2 topic echo --csv": of_ros(
        f"{PARTS[0][0]},{PARTS[1][0]},base,{','.join(c[0] for c in XYZ)},0,0,0,1",
        [[*of[1:]] for of in (*PARTS, ["base"] * 20, *XYZ, *[[0] * 20] * 3, [1] * 20)],
    ),
    "transforms without names": of_ros(
        f"{PARTS[0][0]},{PARTS[1][0]},room,base,{','.join(c[0] for c in XYZ)},0,0,0,1",
        [
            [*of[1:]]
            for of in (*PARTS, ["room"] * 20, ["base"] * 20, *XYZ, *[[0] * 20] * 3, [1] * 20)
        ],
    ),
    "rostopic echo -p of transforms": of_ros(
        "%time,field.transforms0.header.stamp,field.transforms0.child_frame_id,"
        + ",".join(f"field.transforms0.transform.translation.{k}" for k in "xyz"),
        [LATE, NS, ["base"] * 20, *XYZ],
    ),
    "PlotJuggler": of_ros(
        "__time,/arm/radar/pose/header/stamp,"
        + ",".join(f"/arm/radar/pose/pose/position/{k}" for k in "xyz"),
        [[f"{1e-9 * v:.6f}" for v in LATE], [f"{1e-9 * v:.6f}" for v in NS], *XYZ],
    ),
    "dates": of_ros(
        "time,x,y,z",
        [[datetime.fromtimestamp(1e-9 * v, UTC).isoformat() for v in NS], *XYZ],
    ),
    "dates without a zone": of_ros(
        "timestamp,x,y,z",
        [[f"{datetime.fromtimestamp(1e-9 * v, UTC):%Y-%m-%d %H:%M:%S.%f}" for v in NS], *XYZ],
    ),
    "nanoseconds": of_ros("timestamp,x,y,z", [NS, *XYZ]),
    "microseconds": of_ros("t,x,y,z", [[v // 1000 for v in NS], *XYZ]),
    "milliseconds": of_ros("time,x,y,z", [[v // 10**6 for v in NS], *XYZ]),
}


@pytest.mark.parametrize("name", OF_ROS)
def test_stamps_of_ros_are_seconds_since_1970(tmp_path, name):
    log = read(tmp_path, OF_ROS[name])
    assert log.times_s - 1.7e9 == pytest.approx(TIMES, abs=1e-6)
    assert np.allclose(log.positions, POSITIONS)


def test_stamps_of_whole_seconds_are_refused_even_with_keep_good(tmp_path):
    text = of_ros(f"header.stamp.sec,{POSE}", [PARTS[0], *XYZ])
    (tmp_path / "log.csv").write_text(text)
    for keep_good in (False, True):  # the hint must not be one that leaves nearly all rows out
        with pytest.raises(UserError, match="do not increase at 19 rows") as caught:
            read_log(tmp_path / "log.csv", keep_good=keep_good)
        assert "keep" not in str(caught.value)


MOTION_CAPTURE = {
    "Motive": motive(PLAIN),
    "Motive with markers": motive(PLAIN, marker=True),
    "Motive in millimetres": motive(PLAIN, unit="Millimeters", scale=1e3),
    "Vicon": of_vicon(),
    "Vicon with other tables": "Devices\n1000\nFrame,Sub Frame,Fx\n,,N\n1,0,2\n\n"
    + of_vicon()
    + "\nTrajectories\n25\n,,cart:M1,,\nFrame,Sub Frame,X,Y,Z\n,,mm,mm,mm\n1,0,5,6,7\n",
    "Qualisys": of_qualisys(),
    "lines of another logger": "Arm of the laboratory\nspeed,0.05,m/s\n\n"
    + text_of(PLAIN * [1, 1e3, 1e3, 1e3], "t,x_mm,y_mm,z_mm"),
    "units in a line of their own": text_of(PLAIN * [1e3, 1e3, 1e3, 1e3], "t,x,y,z\nms,mm,mm,mm"),
}


@pytest.mark.parametrize("name", MOTION_CAPTURE)
def test_lines_before_the_names_are_understood(tmp_path, name):
    log = read(tmp_path, MOTION_CAPTURE[name])
    assert np.allclose(log.times_s, TIMES)
    assert np.allclose(log.positions, POSITIONS)
    if name.startswith(("Motive", "Vicon")):
        assert np.allclose(log.rotations.as_matrix(), TURN.as_matrix(), atol=1e-6)


def test_rows_that_motion_capture_lost_are_left_out(tmp_path):
    lines = motive(PLAIN).splitlines()
    at = next(k for k, line in enumerate(lines) if line.startswith("0,0.0"))
    lines[at] = "0,0.000000,,,,,,,,"
    (tmp_path / "log.csv").write_text("\n".join(lines))
    with pytest.raises(UserError, match="1 of 20 rows hold NaN, first row 1; keep_good"):
        read_log(tmp_path / "log.csv", keep_good=False)
    log = read_log(tmp_path / "log.csv", keep_good=True)
    assert np.allclose(log.positions, POSITIONS[1:])


@pytest.mark.parametrize(
    "text", [motive(PLAIN, bodies=("radar", "carton")), of_vicon(("radar", "carton"))]
)
def test_several_bodies_are_refused_by_name(tmp_path, text):
    with pytest.raises(UserError, match=r"2 bodies: .*carton.*delete the columns of the others"):
        read(tmp_path, text)


w_first = TURN.as_quat()[[3, 0, 1, 2]]
w_last = TURN.as_quat()
ORIENTATION = ",".join(f"pose.orientation.{k}" for k in "xyzw")
TURNS = {
    "time_s,x_m,y_m,z_m,qw,qx,qy,qz": w_first,
    "time_s,x_m,y_m,z_m,qx,qy,qz,qw": w_last,
    "# timestamp,tx,ty,tz,qx,qy,qz,qw": w_last,
    "time," + ",".join(f"position.{k}" for k in "xyz") + "," + ORIENTATION: w_last,
    "time_s,x_m,y_m,z_m,rx,ry,rz": TURN.as_rotvec(),
    "time_s,x_m,y_m,z_m,Rx [rad],Ry [rad],Rz [rad]": TURN.as_rotvec(),
    "timestamp," + ",".join(f"actual_TCP_pose_{k}" for k in range(6)): TURN.as_rotvec(),
}


@pytest.mark.parametrize("names", TURNS)
def test_orientations_are_read_by_their_names(tmp_path, names):
    turns = np.broadcast_to(TURNS[names], (20, len(TURNS[names])))
    log = read(tmp_path, text_of(np.column_stack([PLAIN, turns]), names))
    assert np.allclose(log.rotations.as_matrix(), TURN.as_matrix(), atol=1e-6)
    assert any("rotation vectors" in note for note in log.notes) == (turns.shape[1] == 3)


@pytest.mark.parametrize(
    "names",
    [
        "roll,pitch,yaw",
        "A,B,C",
        "w,p,r",
        "rx_deg,ry_deg,rz_deg",
        "Alpha,Beta,Gamma",
        "phi,theta,psi",
        "q0,q1,q2,q3",
        "r11,r12,r13",
        "yaw_deg",
    ],
)
def test_angles_of_other_conventions_are_refused_if_they_turn(tmp_path, names):
    angles = [0, 0, 90.0, 0][: 1 + names.count(",")] if "," in names else [90.0]
    table = np.column_stack([PLAIN, np.tile(angles, (20, 1))])
    with pytest.raises(UserError, match="holds an orientation that is not read"):
        read(tmp_path, text_of(table, f"time_s,x_m,y_m,z_m,{names}"))
    table[:, 4:] = 0
    log = read(tmp_path, text_of(table, f"time_s,x_m,y_m,z_m,{names}"))
    assert log.quaternions is None
    assert names.replace(",", ", ") in log.notes[0]


def test_rotation_vectors_in_degrees_are_refused(tmp_path):
    table = np.column_stack([PLAIN, np.tile([0, 0, 90.0], (20, 1))])
    with pytest.raises(UserError, match="up to 90 long, no rotation vectors in radians"):
        read(tmp_path, text_of(table, "time_s,x_m,y_m,z_m,rx,ry,rz"))


def test_columns_that_are_not_read_are_named_and_may_hold_text(tmp_path):
    rows = [f"{t},moving,{x},{y},{z},1.5" for t, x, y, z in PLAIN]
    log = read(tmp_path, "time_s,state,x_m,y_m,z_m,vx\n" + "\n".join(rows))
    assert np.allclose(log.positions, POSITIONS)
    assert log.notes == ("columns of log.csv that are not read: state, vx",)


def test_quaternions_without_names_are_reported_as_assumed(tmp_path):
    table = np.column_stack([PLAIN, np.tile(w_first, (20, 1))])
    log = read(tmp_path, text_of(table, ""))
    assert np.allclose(log.rotations.as_matrix(), TURN.as_matrix(), atol=1e-6)
    assert "read as time x y z qw qx qy qz" in log.notes[0]


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        ("time_s,x_m,y_m,z_m\n0,1,a,0\n", "row 1, column 'y_m'"),
        ("time_s,x_m,y_m,z_m\n0,1,0\n", "rows and names differ in number, expected 4, got 3"),
        ("time_s,x_m,y_m,z_m,rx,ry\n0,1,0,0,0,0\n", "columns are missing"),
        ("time_s,x_m,y_m,z_m,pos_x\n0,1,0,0,0\n", "two columns are x: 'x_m' and 'pos_x'"),
        ("time_s,x_m,y_m,z_m\n0,,0,0\n", "1 of 1 rows hold NaN"),
    ],
)
def test_what_cannot_be_read_names_row_and_column(tmp_path, text, reported):
    with pytest.raises(UserError, match=reported):
        read(tmp_path, text)


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "ms"), (1e6, "us"), (1e9, "ns")])
def test_times_of_another_unit_are_refused(tmp_path, factor, unit):
    log = read(tmp_path, text_of(PLAIN * [factor, 1, 1, 1], "time_s,x_m,y_m,z_m"))
    with pytest.raises(UserError, match=f"name the column time_{unit}"):
        log_track(log, 20, frame_period_s=0.04, start_time_s=0.0, keep_good=False)
