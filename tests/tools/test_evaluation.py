"""The evaluation: statistics against numbers worked out by hand, worlds that are none, and where the teacher drives."""

import itertools
import json
import math
import sys
from dataclasses import asdict
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from omnibotd.control_protocol import RpcError
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Pose2D, Twist2D
from tools.evaluation.__main__ import main
from tools.evaluation.summary import Run, Summary
from tools.sim import virtual_time
from tools.sim.teacher import (
    CLEARANCE,
    SAVE_TRIES,
    SPEED,
    Area,
    NoWay,
    Teacher,
    clear_way,
    save_dock,
    towards,
)
from tools.sim.virtual_robot import somewhere
from tools.sim.world_plugin import WorldError, load_world


def _run(error_m: float, yaw_error: float, result: str) -> Run:
    goal = Pose2D(1.0, 2.0, math.pi)
    return Run(Pose2D(), goal, Pose2D(1.0, 2.0 - error_m, -math.pi + yaw_error), 12.5, result)


RUNS = [
    _run(0.10, 0.01, "ARRIVED"),
    _run(0.20, -0.02, "ARRIVED"),
    _run(0.60, 0.03, "LOST"),
    _run(1.50, 0.50, "LOST"),
]


def test_errors_of_a_run_and_heading_across_the_half_turn() -> None:
    run = _run(0.30, 0.02, "ARRIVED")
    assert run.error_m == pytest.approx(0.30)
    assert run.error_rad == pytest.approx(0.02)
    assert _run(0.30, -0.02, "ARRIVED").error_rad == pytest.approx(0.02)


def test_json_of_a_run() -> None:
    assert json.loads(json.dumps(_run(0.5, 0.0, "LOST").as_json())) == {
        "start": [0.0, 0.0, 0.0],
        "goal": [1.0, 2.0, math.pi],
        "final": [1.0, 1.5, -math.pi],
        "error_m": pytest.approx(0.5),
        "error_rad": pytest.approx(0.0, abs=1e-12),
        "seconds": 12.5,
        "result": "LOST",
    }


def test_summary_by_hand() -> None:
    """Errors 0.1, 0.2, 0.6, 1.5: mean 0.6; squares of deviations 0.25 + 0.16 + 0 + 0.81 = 1.22 over 3."""
    summary = Summary.of(RUNS)
    assert summary.n == 4
    assert summary.mean_m == pytest.approx(0.6)
    assert summary.sd_m == pytest.approx(math.sqrt(1.22 / 3))
    assert summary.median_m == pytest.approx(0.4)
    assert summary.max_m == pytest.approx(1.5)
    assert summary.median_deg == pytest.approx(math.degrees(0.025))
    assert summary.results == {"ARRIVED": 2, "LOST": 2}


def test_failed_runs_count_and_the_limit_is_within() -> None:
    runs = [Run(Pose2D(), Pose2D(), Pose2D(x), 1.0, "TIMEOUT") for x in (0.1, 0.15, 0.25, 0.5, 1.0, 1.01)]
    assert Summary.of(runs).within == {
        "0.10": pytest.approx(1 / 6),
        "0.15": pytest.approx(2 / 6),
        "0.25": pytest.approx(3 / 6),
        "0.50": pytest.approx(4 / 6),
        "1.00": pytest.approx(5 / 6),
    }


def test_one_run_has_no_spread_and_none_no_summary() -> None:
    assert Summary.of(RUNS[:1]).sd_m == 0.0
    with pytest.raises(ValueError, match="no runs"):
        Summary.of([])


def test_keys_are_those_of_the_contract() -> None:
    expected = ["n", "mean_m", "sd_m", "median_m", "max_m", "within", "median_deg", "results"]
    assert list(asdict(Summary.of(RUNS))) == expected


def test_table_is_in_centimetres() -> None:
    lines = Summary.of(RUNS).table().splitlines()
    assert any(line.split() == ["error,", "mean", "60.0", "cm"] for line in lines)
    assert any(line.split() == ["ended", "LOST", "2"] for line in lines)


class Room:
    """A 6 m x 4 m room with a pillar of 0.5 m radius in its middle."""

    fov_deg = 190.0
    bounds = (0.0, 0.0, 6.0, 4.0)
    dock = (5.5, 2.0, 0.0)

    def free(self, x: float, y: float, radius: float) -> bool:
        inside = radius <= x <= 6.0 - radius and radius <= y <= 4.0 - radius
        return inside and math.hypot(x - 3.0, y - 2.0) >= 0.5 + radius

    def render(self, x: float, y: float, yaw: float, t: float) -> np.ndarray:
        return np.zeros((48, 64, 3), np.uint8)


@pytest.fixture
def plug(monkeypatch):
    """Makes a module `plugged` whose `room(seed)` returns what it is given."""

    def _plug(world: object) -> str:
        module = ModuleType("plugged")
        module.room = lambda seed: world
        monkeypatch.setitem(sys.modules, "plugged", module)
        return "plugged:room"

    return _plug


def test_a_world_is_found_by_name(plug) -> None:
    room = Room()
    assert load_world(plug(room), 3) is room


@pytest.mark.parametrize("name", ["render", "fov_deg", "free", "bounds", "dock"])
def test_what_a_world_lacks_is_named(plug, name: str) -> None:
    parts = {key: getattr(Room(), key) for key in ("render", "fov_deg", "free", "bounds", "dock") if key != name}
    with pytest.raises(WorldError, match=f"has no {name}"):
        load_world(plug(SimpleNamespace(**parts)), 1)


@pytest.mark.parametrize(
    ("part", "value", "message"),
    [
        ("bounds", (0.0, 1.0), r"bounds is \(0.0, 1.0\), expected \(xmin, ymin, xmax, ymax\)"),
        ("dock", (0.0, 1.0, math.nan), r"expected \(x, y, yaw\)"),
        ("fov_deg", "wide", "fov_deg is 'wide'"),
        ("free", lambda self, x, y, radius: 1, "free"),
        ("render", lambda self, x, y, yaw, t: np.zeros((48, 64), np.uint8), r"render returns \(48, 64\) of uint8"),
        ("render", lambda self, x, y, yaw, t: None, "render returns NoneType"),
    ],
)
def test_what_a_world_gets_wrong_is_said(plug, part: str, value: object, message: str) -> None:
    with pytest.raises(WorldError, match=message):
        load_world(plug(type("Wrong", (Room,), {part: value})()), 1)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("tiles", "expected MODULE:FACTORY"),
        ("no_such_module_anywhere:tiles", "PYTHONPATH"),
        ("json:no_such_factory", "no function no_such_factory"),
        ("json:loads", r"loads\(1\) failed: TypeError"),
    ],
)
def test_a_world_that_is_not_there(name: str, message: str) -> None:
    with pytest.raises(WorldError, match=message):
        load_world(name, 1)


def test_area_is_four_metres_or_what_the_walls_leave() -> None:
    assert Area.to_teach(Room()) == Area(1.0, 0.5, 5.0, 3.5)
    assert Area.to_teach(Room(), centre=(5.5, 2.0)) == Area(3.5, 0.5, 5.5, 3.5)
    with pytest.raises(NoWay):
        Area.to_teach(SimpleNamespace(bounds=(0.0, 0.0, 1.0, 1.0)))


def test_the_pillar_stands_in_the_way() -> None:
    assert not clear_way(Room(), (1.0, 2.0), (5.0, 2.0))
    assert clear_way(Room(), (1.0, 1.0), (5.0, 1.0))
    start = somewhere(Room())
    assert 0.67 <= math.hypot(start.x - 3.0, start.y - 2.0) < 0.8


def test_turns_on_the_spot_before_driving_off() -> None:
    assert towards(Pose2D(), (0.0, 2.0)).vx == 0.0
    assert towards(Pose2D(), (0.0, 2.0)).wz > 0.0
    assert towards(Pose2D(), (2.0, 0.0)) == Twist2D(SPEED, 0.0)


class IdealRobot:
    """Does what it is told, without delay, as long as the last order holds."""

    def __init__(self) -> None:
        self.world = Room()
        self.pose = Pose2D(1.0, 2.0)
        self.track = [self.pose]

    async def drive(self, twist: Twist2D) -> None:
        assert abs(twist.vx) <= SPEED
        self.pose = self.pose @ Pose2D(twist.vx * 0.1, 0.0, twist.wz * 0.1)
        self.track.append(self.pose)

    def teleport(self, pose: Pose2D) -> None:
        self.pose = pose

    async def call(self, method: str, **params: object) -> dict[str, object]:
        raise AssertionError("only `teach` asks for more than driving")


def _wander(seed: int) -> list[Pose2D]:
    async def main() -> list[Pose2D]:
        robot = IdealRobot()
        await Teacher(robot, Area.to_teach(robot.world), seed).wander(120.0)
        return robot.track

    return virtual_time.run(main())


def test_teacher_covers_the_room_and_keeps_off_the_pillar() -> None:
    track = _wander(1)
    assert all(Room().free(pose.x, pose.y, CLEARANCE - 0.1) for pose in track)
    metres = sum(a.distance(b) for a, b in itertools.pairwise(track))
    assert metres > 15.0
    assert len({(pose.x > 3.0, pose.y > 2.0) for pose in track}) == 4
    assert track == _wander(1)


def test_parking_ends_in_place() -> None:
    async def main() -> tuple[Pose2D, Pose2D]:
        robot = IdealRobot()
        await Teacher(robot, Area.to_teach(robot.world), 1).park(Pose2D(*robot.world.dock))
        return robot.track[-1], robot.pose

    driven, pushed = virtual_time.run(main())
    assert pushed == Pose2D(*Room.dock)
    assert driven.distance(pushed) < 0.04
    assert abs(driven.yaw) < 0.1


def test_dock_is_saved_once_the_robot_knows_where_it_is() -> None:
    class Unsure(IdealRobot):
        def __init__(self, refusals: list[ErrorName]) -> None:
            super().__init__()
            self.refusals = refusals

        async def call(self, method: str, **params: object) -> dict[str, object]:
            if self.refusals:
                raise RpcError.named(self.refusals.pop(), "no")
            return {"name": params["name"]}

    async def main(refusals: list[ErrorName]) -> dict[str, object]:
        robot = Unsure(refusals)
        dock = Pose2D(*Room.dock)
        return await save_dock(robot, Teacher(robot, Area.to_teach(robot.world), 1), "dock", dock)

    assert virtual_time.run(main([ErrorName.LOST] * (SAVE_TRIES - 1))) == {"name": "dock"}
    for refusals in ([ErrorName.LOST] * SAVE_TRIES, [ErrorName.CAMERA_DOWN]):
        with pytest.raises(RpcError, match="no"):
            virtual_time.run(main(refusals))


def test_usage_errors_are_found_before_anything_runs(tmp_path, capsys) -> None:
    good = ["goto", "--world", "a:b", "--json", str(tmp_path / "out.json")]
    for wrong in (["--runs", "0"], ["--teach", "soon"], ["--preset", "thesis"], ["--json", "/no/such/dir/x"]):
        with pytest.raises(SystemExit) as end:
            main([*good, *wrong])
        assert end.value.code == 2
        assert wrong[0] in capsys.readouterr().err


def test_a_missing_world_is_one_line(tmp_path, capsys) -> None:
    assert main(["dock", "--world", "no_such_module:x", "--json", str(tmp_path / "out.json")]) == 1
    assert "PYTHONPATH" in capsys.readouterr().err
