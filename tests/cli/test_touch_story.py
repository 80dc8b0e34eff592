"""`bough touch` as a user types it: record, fit, train, evaluate, and what it refuses."""

import json
import re
from types import SimpleNamespace

import numpy as np
import pytest
from bough.cli.main import main
from oracles import json_page

pytest.importorskip("sklearn")
rosbags = pytest.importorskip("rosbags")


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """Record one short round."""
    out = tmp_path_factory.mktemp("touch") / "recorded"
    assert main(["touch", "record", "--out", str(out), "--rounds", "1", "--seconds", "3"]) == 0
    return out


@pytest.fixture(scope="module")
def small(simulated, tmp_path_factory):
    """Return a folder with some of the recordings."""
    out = tmp_path_factory.mktemp("touch") / "small"
    out.mkdir()
    for k in [*range(16, 28), *range(72, 80)]:
        (out / f"{k:05d}.csv").write_bytes((simulated / f"{k:05d}.csv").read_bytes())
    (out / "recordings.csv").write_bytes((simulated / "recordings.csv").read_bytes())
    return out


@pytest.fixture(scope="module")
def trained(small, inside, tmp_path_factory):
    """Train on the small folder."""
    out = tmp_path_factory.mktemp("touch") / "model"
    done = inside("touch", "train", small, "--out", out, "--kind", "forest", "--seed", 0, "--json")
    assert done.code == 0, done.err
    json_page.check("touch train", json.loads(done.out))
    return out / "model.npz"


def test_every_place_is_touched_from_every_side(simulated):
    """Write 112 recordings; most obstacles are met, no twin is; the same seed gives the same bytes."""
    rows = (simulated / "recordings.csv").read_text().splitlines()[1:]
    assert len(rows) == 112 and len({r.split(",", 1)[1] for r in rows}) == 2 * 28 + 1
    contact = [np.loadtxt(simulated / r.split(",")[0], delimiter=",", skiprows=1)[:, -1].any() for r in rows]
    assert sum(contact[:56]) > 45 and not any(contact[56:])


def test_recording_is_repeatable(simulated, inside, tmp_path):
    """Give the same bytes for the same seed and force, which are those of a command without them."""
    same = ["--rounds", 1, "--seconds", 3, "--seed", 0, "--force", 2]
    done = inside("touch", "record", "--out", tmp_path / "b", *same, "--json")
    assert done.code == 0, done.err
    json_page.check("touch record", json.loads(done.out))
    for name in ("00000.csv", "00099.csv", "recordings.csv"):
        assert (tmp_path / "b" / name).read_bytes() == (simulated / name).read_bytes()


def test_fit_finds_the_sensor_that_recorded(simulated, tmp_path, capsys):
    """Find the rate, and noise in motion within a factor of two of what recorded (gravity and payload add to it)."""
    assert main(["touch", "fit", str(simulated), "--out", str(tmp_path)]) == 0
    assert "10.0 Hz; noise at rest" in capsys.readouterr().out
    found, given = (json.loads((p / "sensor.json").read_text()) for p in (tmp_path, simulated))
    json_page.check("touch fit", found)
    assert found["rate"] == pytest.approx(10.0, rel=1e-4)
    assert all(0.5 < a / b < 2.0 for a, b in zip(found["still"][:3], given["still"][:3], strict=True))


def test_evaluate_leaves_one_out(small, tmp_path, capsys):
    """Write a page with its figures inside and numbers that agree with each other."""
    assert main(["touch", "evaluate", str(small), "--out", str(tmp_path), "--kind", "forest", "--seed", "0"]) == 0
    assert re.search(r"AUC 0\.\d+ \(.*specificity .*20 recordings .*report.html", capsys.readouterr().out)
    said = json.loads((tmp_path / "touch.json").read_text())
    json_page.check("touch evaluate", said)
    (free, wrong), (lost, found) = said["confusion"]
    assert free + wrong + lost + found == said["rows"][1] == 20 * 30
    assert said["recall"]["value"] == pytest.approx(found / (found + lost))
    assert said["auc"]["low"] <= said["auc"]["value"] <= said["auc"]["high"]
    page = (tmp_path / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 4 and "http" not in page
    assert (
        f"Of 100 moments of contact {100 * said['recall']['value']:.0f} are felt" in page
        and "bough touch train" in page
    )
    assert {"link", "direction"} == {row[0] for row in said["places"]}


def test_a_model_is_tested_on_what_it_has_not_seen(simulated, small, trained, tmp_path, capsys):
    """Leave the model's own recordings out, and refuse where nothing else is there."""
    out = ["--out", str(tmp_path / "e")]
    assert main(["touch", "evaluate", str(simulated), "--model", str(trained), "--free", str(small), *out]) == 0
    assert json.loads((tmp_path / "e" / "touch.json").read_text())["recordings"] == 112 - 20
    assert main(["touch", "evaluate", str(small), "--model", str(trained), "--out", str(tmp_path / "f")]) == 2
    assert "only recordings that the model was trained on" in capsys.readouterr().err
    assert not (tmp_path / "f").exists()


# ---- bags --------------------------------------------------------------------------------------------------------


def write_bag(path, *, effort=True, command=True, start=1_700_000_000.0, rows=40):
    """Write a ROS 1 bag of three joints and two fingers at 10 Hz, commands at 50 Hz in rad/s."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    t = store.types
    path.parent.mkdir(parents=True, exist_ok=True)
    names = ["j1", "j2", "j3", "finger_1", "finger_2"]
    with Writer(path) as bag:
        states = bag.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store)
        speeds = bag.add_connection("/in/velocity", "std_msgs/msg/Float64MultiArray", typestore=store)
        layout = t["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
        for k in range(rows * 5):
            stamp = int((start + k / 50) * 1e9)
            if command:
                data = np.array([k / 100, 0.0, -k / 100])
                message = t["std_msgs/msg/Float64MultiArray"](layout=layout, data=data)
                bag.write(speeds, stamp, store.serialize_ros1(message, "std_msgs/msg/Float64MultiArray"))
            if k % 5 == 4:
                header = t["std_msgs/msg/Header"](seq=k, stamp=t["builtin_interfaces/msg/Time"](0, 0), frame_id="")
                five = np.arange(5.0) + k
                message = t["sensor_msgs/msg/JointState"](header, names, five, five, five if effort else np.zeros(0))
                bag.write(states, stamp, store.serialize_ros1(message, "sensor_msgs/msg/JointState"))
    return path


def test_bags_are_read_with_their_times_of_contact(tmp_path):
    """Take joints without fingers, the mean of five commands, and a label of a clock ten hours ahead."""
    from bough.learn.touch.read import read_recordings

    write_bag(tmp_path / "touched" / "00.bag")
    write_bag(tmp_path / "free" / "00.bag")
    (tmp_path / "touched" / "meta").mkdir()
    stamps = "expt_idx,start_time,end_time,link\n0,2023-11-15 08:13:21,2023-11-15 08:13:23,GR\n"
    (tmp_path / "touched" / "meta" / "collision_timestamps.csv").write_text(stamps)
    free, touched = read_recordings(tmp_path)
    assert (free.name, touched.name, free.num_dofs) == ("free/00.bag", "touched/00.bag", 3)
    assert free.contact.tolist() == [0] * 40 and touched.link == "GR" and touched.tolerance == 0.5
    # 1 700 000 000 is 22:13:20 UTC: contact from 1 to 3 s of rows at 0.08, 0.18, ... s
    assert np.nonzero(touched.contact)[0].tolist() == list(range(10, 30))
    np.testing.assert_allclose(touched.torque[:2], [[4, 5, 6], [9, 10, 11]])
    np.testing.assert_allclose(touched.command[1:3, 0], [0.07, 0.12])
    np.testing.assert_allclose(np.diff(touched.time), 0.1, atol=1e-6)


def bad_csv(columns, *last):
    """Return a CSV file with these columns of zeros, and a last row."""
    rows = [[k, *[0] * len(columns)] for k in range(4)] + [list(last) or [4, *[0] * len(columns)]]
    return "\n".join([",".join(["time_s", *columns])] + [",".join(map(str, row)) for row in rows]) + "\n"


def joints(count):
    """Return the columns of so many joints."""
    return [f"{p}{k}{u}" for p, u in (("tau", "_Nm"), ("dq", "_rad_s")) for k in range(1, count + 1)]


def csv(*args):
    """Return what writes such a file."""
    return lambda d: (d / "a.csv").write_text(bad_csv(*args))


FAULTS = {
    "empty folder": (lambda d: None, "neither CSV files nor ROS bags"),
    "no efforts": (lambda d: write_bag(d / "a.bag", effort=False), "40 joint states without efforts"),
    "no bag": (lambda d: (d / "a.bag").write_bytes(b"nothing"), "no bag that can be read"),
    "no torques": (csv(["dq1_rad_s"]), "no joint torques"),
    "fewer speeds": (csv(["tau1_Nm", "tau2_Nm", "dq1_rad_s"]), "1 speeds"),
    "label": (csv([*joints(1), "contact"], 4, 0, 0, 2), "row 6, column contact: found 2"),
    "time": (csv(joints(1), 2, 0, 0), "times that increase"),
    "unlabelled": (csv(joints(1)), "no row with contact"),
    "joints": (lambda d: [(d / f"{n}.csv").write_text(bad_csv(joints(n))) for n in (1, 2)],
               "2.csv: found 2 joints; allowed: 1 joints, as 1.csv has"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_bad_data_is_one_line(fault, tmp_path, capsys):
    """Refuse with one line and code 2, and write nothing."""
    data = tmp_path / "data"
    data.mkdir()
    make, said = FAULTS[fault]
    make(data)
    assert main(["touch", "train", str(data), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err.strip().splitlines()
    assert said in error[-1] and error[-1].startswith("bough: ") and not (tmp_path / "out").exists()
    assert all("warning" in line for line in error[:-1])


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["evaluate", "{none}"], "no such folder"),
        (["evaluate", "{small}", "--free", "{small}"], "--free"),
        (["evaluate", "{small}", "--model", "{small}/recordings.csv"], "no whole .npz archive of plain arrays"),
        (["evaluate", "{seven}", "--model", "{model}"], "7 joints; allowed: 6 joints, as the model has"),
        (["record", "--rounds", "0"], "--rounds: found 0"),
        (["record", "--seconds", "1"], "--seconds: found 1"),
        (["record", "--sensor", "{none}"], "no such file"),
    ],
)
def test_bad_options_are_one_line(words, said, small, trained, tmp_path, capsys):
    """Refuse with one line and code 2, and write nothing."""
    seven = tmp_path / "seven"
    seven.mkdir()
    rows = bad_csv([*joints(7), "contact"], 4, *[0] * 14, 1)
    (seven / "a.csv").write_text(rows)
    place = SimpleNamespace(none=tmp_path / "none", small=small, model=trained, seven=seven)
    given = [w.format(**vars(place)) for w in words]
    assert main(["touch", *given, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err.strip().splitlines()
    assert len(error) == 1 and said in error[0] and not (tmp_path / "out").exists()
