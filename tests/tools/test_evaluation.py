"""The evaluation: statistics against numbers worked out by hand, worlds that are none, and where the teacher drives."""

import itertools
import json
import math
import sys
from dataclasses import asdict, replace
from types import ModuleType, SimpleNamespace

import cv2
import numpy as np
import pytest
import yaml

from omnibotd.control_protocol import RpcError
from omnibotd.core.error_name import ErrorName
from omnibotd.core.geometry import Pose2D, Twist2D
from tools.evaluation import campaign
from tools.evaluation.__main__ import main, overview
from tools.evaluation.calibration import Calibration, Estimate
from tools.evaluation.campaign import PlanError, trials
from tools.evaluation.carried import Said, recovered
from tools.evaluation.map_truth import MapTruth
from tools.evaluation.options import parse
from tools.evaluation.plots import draw_runs, draw_table, pooled
from tools.evaluation.summary import Carried, Run, Summary, recovery
from tools.evaluation.tables import markdown
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
from tools.sim.track import Track
from tools.sim.virtual_robot import somewhere
from tools.sim.world_plugin import WorldError, load_world, relit_world


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
        "condition": "nominal",
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
    assert list(asdict(Summary.of(RUNS)))[: len(expected)] == expected


def test_a_false_arrival_is_one_that_says_it_arrived() -> None:
    runs = [_run(0.49, 0.0, "ARRIVED"), _run(0.51, 0.0, "ARRIVED"), _run(3.0, 0.0, "LOST"), _run(0.6, 0.0, "DOCKED")]
    assert [run.false_arrival for run in runs] == [False, True, False, True]
    assert Summary.of(runs).false_arrivals == 2
    assert Summary.of(runs).lost == 1


def _carried(error_m: float, result: str, recovered_s: float | None) -> Run:
    return replace(_run(error_m, 0.0, result), carried=Carried(Pose2D(1.0, 1.0), 3.0, recovered_s))


def test_recovery_counts_the_carried_robots_alone() -> None:
    runs = [
        _carried(0.10, "ARRIVED", 2.0),
        _carried(0.14, "ARRIVED", 4.0),
        _carried(0.16, "ARRIVED", 9.0),
        _carried(2.00, "LOST", None),
        _run(0.1, 0.0, "ARRIVED"),
    ]
    assert recovery(runs) == {
        "n": 4,
        "recovered": 3,
        "median_s": 4.0,
        "p90_s": 9.0,
        "max_s": 9.0,
        "arrived_share": 0.5,
    }
    assert recovery(runs[3:4])["median_s"] is None


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        ([(10.0, 2.0, 0.9), (10.5, 0.2, 0.5), (11.0, 0.2, 0.95), (11.5, 0.2, 0.3)], 1.0),  # unsure again is no matter
        ([(10.0, 0.1, 0.9), (11.0, 0.3, 0.1), (12.0, 0.1, 0.9)], 2.0),  # to be wrong again is
        ([(10.0, 0.1, 0.9), (11.0, 0.3, 0.1)], None),
        ([(10.0, math.inf, 0.0)], None),
        ([], None),
    ],
)
def test_a_carried_robot_has_found_itself_once_it_stays_right(said: list, expected: float | None) -> None:
    assert recovered([Said(*look) for look in said], 10.0) == expected


def test_calibration_by_hand() -> None:
    """Said 0.25 twice, right once; said 1.0 twice, right both times: (2 * 0.25 + 2 * 0) / 4."""
    estimates = [Estimate(0.25, 0.1), Estimate(0.25, 0.26), Estimate(1.0, 0.0), Estimate(1.0, 0.25)]
    calibration = Calibration.of(estimates)
    assert calibration.n == 4
    assert calibration.error == pytest.approx(0.125)
    assert [(b.low, b.high, b.right, b.count) for b in calibration.bins] == [(0.2, 0.3, 0.5, 2), (0.98, 1.0, 1.0, 2)]
    assert Calibration.of([]) == Calibration(0, 0.0, ())
    assert pooled([asdict(calibration), asdict(calibration)])["error"] == pytest.approx(0.125)
    assert pooled([asdict(calibration), asdict(calibration)])["n"] == 8


def _grid(metric: bool, scale: float = 1.0) -> tuple[MapTruth, Pose2D]:
    """Nodes 0.5 m apart, the map turned by 1 rad, shifted, and `scale` times smaller than the world."""
    world_from_map = Pose2D(3.0, -2.0, 1.0)
    in_map = [Pose2D(0.5 * i / scale, 0.5 * j / scale, 0.1 * i) for i in range(8) for j in range(8)]
    in_world = [world_from_map @ Pose2D(scale * p.x, scale * p.y, p.yaw) for p in in_map]
    both = (np.array([(p.x, p.y, p.yaw) for p in poses]) for poses in (in_map, in_world))
    return MapTruth(*both, metric=metric), world_from_map


@pytest.mark.parametrize("scale", [1.0, 1.1])
def test_a_pose_of_the_map_lies_among_the_same_nodes_in_the_world(scale: float) -> None:
    truth, world_from_map = _grid(metric=True, scale=scale)
    for x, y in ((1.3, 0.7), (4.5, 4.5)):
        found, expected = truth.world_from(Pose2D(x / scale, y / scale, 3.0), 0), world_from_map @ Pose2D(x, y, 3.0)
        assert found.distance(expected) < 1e-9
        assert math.remainder(found.yaw - expected.yaw, math.tau) == pytest.approx(0.0, abs=1e-9)


def test_a_few_misplaced_nodes_are_outvoted() -> None:
    truth, world_from_map = _grid(metric=True)
    truth.in_world[[9, 18], :2] += 2.0
    assert truth.world_from(Pose2D(0.7, 0.7), 0).distance(world_from_map @ Pose2D(0.7, 0.7)) < 1e-9


def test_in_a_map_that_is_not_metric_the_node_seen_decides() -> None:
    truth, world_from_map = _grid(metric=False)
    truth.in_world[5, :2] += (1.0, 0.0)
    pose = Pose2D(0.2, 2.4, 0.3)
    expected = world_from_map @ pose
    assert truth.world_from(pose, 5).distance(Pose2D(expected.x + 1.0, expected.y)) < 1e-9
    assert truth.world_from(pose, 6).distance(expected) < 1e-9


def test_the_track_is_read_at_the_nearest_stamp(tmp_path) -> None:
    track = Track.of([(1.0, Pose2D(1.0)), (2.0, Pose2D(2.0)), (3.0, Pose2D(3.0, 0.5, -1.0))])
    track.save(tmp_path / "track.npz")
    again = Track.load(tmp_path / "track.npz")
    assert [again.at(stamp).x for stamp in (0.0, 1.4, 1.6, 2.0, 9.0)] == [1.0, 1.0, 2.0, 2.0, 3.0]
    assert again.at(3.1) == Pose2D(3.0, 0.5, -1.0)


def test_table_is_in_centimetres() -> None:
    lines = Summary.of(RUNS).table().splitlines()
    assert any(line.split() == ["error,", "mean", "60", "cm"] for line in lines)
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
    assert Area(1.0, 0.5, 5.0, 3.5).half() == Area(1.0, 0.5, 3.0, 3.5)
    assert Area(1.0, 0.0, 3.0, 4.0).half() == Area(1.0, 0.0, 3.0, 2.0)
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
    wrongs = (["--runs", "0"], ["--teach", "soon"], ["--preset", "best"], ["--json", "/no/such/dir/x"])
    for wrong in (*wrongs, ["--condition", "fog"], ["--condition", "sun,night"]):
        with pytest.raises(SystemExit) as end:
            main([*good, *wrong])
        assert end.value.code == 2
        assert wrong[0] in capsys.readouterr().err


def test_presets_have_their_own_teaching_and_light_its_own_lights(tmp_path) -> None:
    base = ["--world", "a:b", "--json", str(tmp_path / "out.json")]
    assert parse(["goto", *base], ["goto"]).teach == 300.0
    assert parse(["goto", *base, "--preset", "thesis"], ["goto"]).teach == 75 * 60.0
    assert parse(["goto", *base, "--condition", "nominal"], ["goto"]).condition == ()
    assert parse(["goto", *base, "--condition", "sun,people"], ["goto"]).condition == ("sun", "people")
    with pytest.raises(SystemExit):
        parse(["light", *base, "--condition", "people,sun"], ["light"])


def test_a_plan_is_every_combination_once() -> None:
    entry = {"experiment": ["goto", "kidnap"], "world": "w:f", "runs": 5, "preset": ["default", "thesis"]}
    todo = trials([entry, {**entry, "experiment": "goto"}])
    assert [(t.experiment, t.preset, t.teach) for t in todo] == [
        ("goto", "default", 300.0),
        ("kidnap", "default", 300.0),
        ("goto", "thesis", 4500.0),
        ("kidnap", "thesis", 4500.0),
    ]
    assert todo[0].arguments == [
        *("goto", "--world", "w:f", "--seed", "1", "--condition", "nominal"),
        *("--preset", "default", "--teach", "300.0", "--runs", "5"),
    ]
    assert [t.teach for t in trials([{**entry, "preset": "default"}], [60.0, 120.0])] == [60.0, 60.0, 120.0, 120.0]
    assert len({t.name for t in todo}) == len(todo)


@pytest.mark.parametrize(
    ("plan", "message"),
    [
        (None, "a plan is a list"),
        ([{"experiment": "goto", "runs": 3}], "entry 1: experiment, world and runs"),
        ([{"experiment": "goto", "world": "w:f", "runs": 3, "light": "sun"}], "entry 1"),
        ([{"experiment": "goto", "world": "w:f", "runs": 3, "preset": "best"}], "no preset 'best'"),
    ],
)
def test_a_plan_that_is_none(plan: object, message: str) -> None:
    with pytest.raises(PlanError, match=message):
        trials(plan)


def _result(meta: dict[str, object], runs: list[Run]) -> dict[str, object]:
    estimates = [Estimate(0.9, 0.1)]
    described = {
        "world": "w:f",
        "seed": 1,
        "preset": "default",
        "teach_s": 300.0,
        "conditions": [],
        "bounds": [0.0, 0.0, 6.0, 4.0],
    } | meta
    return {"meta": described, "runs": [run.as_json() for run in runs], "summary": overview(runs, estimates)}


def test_the_table_has_a_row_for_each_result_and_each_light() -> None:
    lights = [replace(run, condition=name) for run, name in zip(RUNS, ["sun", "sun", "night", "night"], strict=True)]
    carried = [_carried(0.1, "ARRIVED", 2.0), _carried(1.0, "TIMEOUT", None)]
    results = [_result({"experiment": "light"}, lights), _result({"experiment": "kidnap"}, carried)]
    rows = [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in markdown(results).splitlines()]
    assert [row[3] for row in rows[2:]] == ["all", "sun", "night", "nominal"]
    assert [*rows[2][6:9], *rows[2][10:12]] == ["4", "40 cm", "150 cm", "25.0 %", "50.0 %"]
    assert rows[5][13:] == ["0", "1", "0", "0.100", "1/2, 2.0 s"]


def test_pictures_are_drawn(tmp_path) -> None:
    carried = [_carried(0.1, "ARRIVED", 2.0), _carried(1.0, "TIMEOUT", None)]
    results = [_result({"experiment": "goto"}, RUNS), _result({"experiment": "kidnap"}, carried)]
    draw_runs(results[0], tmp_path / "runs.png")
    draw_table(results, tmp_path / "table.png")
    for name in ("runs.png", "table.png"):
        picture = cv2.imread(str(tmp_path / name))
        assert picture.shape[1] > 1000
        assert (picture < 200).any(axis=2).mean() > 0.005


def test_the_plan_runs_what_is_missing_and_tells_what_failed(tmp_path, capsys) -> None:
    plan = tmp_path / "plan.yaml"
    plan.write_text("- {experiment: goto, world: 'no_such_module:x', runs: 1, teach: 60}\n", "utf-8")
    assert campaign.main([str(plan), "--out", str(tmp_path / "out"), "--jobs", "1"]) == 1
    assert "PYTHONPATH" in capsys.readouterr().err
    trial = trials(yaml.safe_load(plan.read_text("utf-8")))[0]
    (tmp_path / "out" / f"{trial.name}.json").write_text(json.dumps(_result({"experiment": "goto"}, RUNS)), "utf-8")
    assert campaign.main([str(plan), "--out", str(tmp_path / "out")]) == 0
    assert "| goto | w:f | 1 | nominal | default | 300 s | 4 | 40 cm |" in (tmp_path / "out/table.md").read_text(
        "utf-8"
    )
    assert json.loads((tmp_path / "out/table.json").read_text("utf-8"))[0]["summary"]["n"] == 4
    plan.write_text("goto", "utf-8")
    assert campaign.main([str(plan), "--out", str(tmp_path / "out")]) == 2


def test_a_world_is_relit_where_its_factory_can(monkeypatch) -> None:
    module = ModuleType("lamps")

    def dimmed(seed: int, light: str = "nominal") -> Room:
        if light == "night":
            raise ValueError("never dark here")
        if light == "sun":
            raise ZeroDivisionError
        return Room()

    module.dimmed, module.plain = dimmed, lambda seed: Room()
    monkeypatch.setitem(sys.modules, "lamps", module)
    assert isinstance(relit_world("lamps:dimmed", 1, "lamps_off"), Room)
    assert relit_world("lamps:dimmed", 1, "night") is None
    assert relit_world("lamps:plain", 1, "lamps_off") is None
    with pytest.raises(WorldError, match="ZeroDivisionError"):
        relit_world("lamps:dimmed", 1, "sun")


def test_a_missing_world_is_one_line(tmp_path, capsys) -> None:
    assert main(["dock", "--world", "no_such_module:x", "--json", str(tmp_path / "out.json")]) == 1
    assert "PYTHONPATH" in capsys.readouterr().err
