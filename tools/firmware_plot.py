"""The firmware in the simulator: speed control, counting and odometry, in numbers and as a picture.

Launcher: tools/firmware-plot.
"""

from __future__ import annotations

import argparse
import random
import sys
from dataclasses import dataclass
from pathlib import Path
from statistics import pstdev

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tools.avr.bench import Bench
from tools.avr.boards import BOARDS, Board
from tools.avr.building import BuildError, ToolsMissing
from tools.avr.robot import FULL_SPEED, LEFT, RIGHT

INK, FAINT, WARM = "#20507a", "#b0b0b0", "#b0522d"
STEPS = (500, 1500, 3000)  # ticks/s
STEP_SECONDS = 1.0
REVERSED_AFTER = 0.6  # s
SPEEDS = (100, 200, 400, 800, 1600, 2400, 3200)  # ticks/s
SETTLING, MEASURING, SAMPLING = 1.5, 2.0, 0.01  # s
RATES = (5_000, 10_000, 20_000, 30_000, 40_000, 60_000, 80_000)  # edges/s a wheel
DRIVES = 12


@dataclass(frozen=True, slots=True)
class Motor:
    """A motor beside what the firmware takes it for: speed at full PWM, and the share of PWM lost to friction."""

    name: str
    strength: float
    friction: float

    def fit(self, bench: Bench) -> None:
        for side in (LEFT, RIGHT):
            bench.robot.motor(side, self.strength * FULL_SPEED / (1.0 - self.friction), friction=self.friction)


MOTORS = (
    Motor("as configured", 1.0, 0.0),
    Motor("20 % weak, 10 % friction", 0.8, 0.1),
    Motor("30 % strong, 20 % friction", 1.3, 0.2),
)

Curve = list[tuple[float, float]]
Odometry = tuple[tuple[int, int], tuple[int, int]]


def step_response(board: Board, motor: Motor, target: int) -> Curve:
    """(seconds, true ticks/s) from rest to `target`, and then to its opposite."""
    with Bench(board) as bench:
        motor.fit(bench)
        bench.greet()
        begin, curve = bench.robot.now, []
        while (t := bench.robot.now - begin) < STEP_SECONDS + REVERSED_AFTER:
            asked = target if t < STEP_SECONDS else -target
            bench.hold(asked, asked, 0.01)
            curve.append((t, bench.robot.speeds[LEFT]))
        return curve


def steady(board: Board, motor: Motor, target: int) -> tuple[float, float]:
    """Mean error of the speed over some seconds, and its ripple (standard deviation), both in percent of `target`."""
    with Bench(board) as bench:
        motor.fit(bench)
        bench.greet()
        bench.hold(target, target, SETTLING)
        begin, start, speeds = bench.robot.ticks[LEFT], bench.robot.now, []
        while bench.robot.now < start + MEASURING:
            bench.hold(target, target, SAMPLING)
            speeds.append(bench.robot.speeds[LEFT])
        mean = (bench.robot.ticks[LEFT] - begin) / (bench.robot.now - start)
        return 100.0 * (mean - target) / target, 100.0 * pstdev(speeds) / target


def edges_missed(board: Board, rate: int) -> int:
    """Of both wheels in a second, one forward and one backward, telemetry and set-points going on."""
    with Bench(board) as bench:
        bench.greet()
        bench.robot.spin(LEFT, rate)
        bench.robot.spin(RIGHT, -rate)
        bench.hold(0, 0, 1.0)
        bench.robot.spin(LEFT, 0.0)
        bench.robot.spin(RIGHT, 0.0)
        return sum(abs(counted - true) for counted, true in zip(*odometry(bench), strict=True))


def odometry(bench: Bench) -> Odometry:
    """Left and right as the firmware has counted, and as they passed; wheels at rest."""
    report = bench.report()
    return (report.left_ticks, report.right_ticks), bench.robot.ticks


def drive_about(board: Board, seed: int) -> list[Odometry]:
    """Odometry after random drives, the wheels run out each time."""
    rng = random.Random(seed)
    with Bench(board) as bench:
        bench.greet()
        stops = [odometry(bench)]
        for _ in range(DRIVES):
            bench.hold(rng.randrange(-3500, 3500), rng.randrange(-3500, 3500), rng.uniform(0.2, 1.5))
            bench.rest()
            stops.append(odometry(bench))
    return stops


@dataclass(frozen=True, slots=True)
class Results:
    """What was measured: `steady` has mean error and ripple by motor and speed."""

    steps: dict[int, Curve]
    steady: dict[str, list[tuple[float, float]]]
    missed: list[int]
    stops: list[Odometry]

    @property
    def worst_odometry(self) -> int:
        """Ticks."""
        return max(abs(counted - true) for stop in self.stops for counted, true in zip(*stop, strict=True))


def measure(board: Board) -> Results:
    """Everything; half a minute."""
    return Results(
        steps={target: step_response(board, MOTORS[0], target) for target in STEPS},
        steady={motor.name: [steady(board, motor, speed) for speed in SPEEDS] for motor in MOTORS},
        missed=[edges_missed(board, rate) for rate in RATES],
        stops=drive_about(board, 1),
    )


def rise_time(curve: Curve, target: int) -> float:
    """Seconds from 10 to 90 percent of the first step."""
    reached = [next(t for t, speed in curve if speed >= share * target) for share in (0.1, 0.9)]
    return reached[1] - reached[0]


def overshoot(curve: Curve, target: int) -> float:
    """Percent of the first step."""
    return 100.0 * (max(speed for t, speed in curve if t < STEP_SECONDS) / target - 1.0)


def table(results: Results) -> str:
    """The results in words."""
    lines = [
        f"step to {target:5d} ticks/s: rise {1e3 * rise_time(curve, target):.0f} ms, "
        f"overshoot {overshoot(curve, target):.1f} %"
        for target, curve in results.steps.items()
    ]
    lines += [
        f"motors {name}: mean error at most {max(abs(error) for error, _ in rows):.2f} %, "
        f"ripple {min(ripple for _, ripple in rows):.1f} to {max(ripple for _, ripple in rows):.1f} %"
        for name, rows in results.steady.items()
    ]
    lines += [
        f"{rate:6d} edges/s a wheel: {missed} of {2 * rate} missed"
        for rate, missed in zip(RATES, results.missed, strict=True)
    ]
    return "\n".join([*lines, f"odometry after each of {DRIVES} drives: off by at most {results.worst_odometry} ticks"])


def draw(results: Results, board: Board, path: Path) -> None:
    """Three panels."""
    figure = Figure(figsize=(11.5, 3.8), layout="constrained")
    for axes, draw_panel in zip(figure.subplots(1, 3), (_draw_steps, _draw_steady, _draw_odometry), strict=True):
        draw_panel(axes, results)
    motors = f"motors of {FULL_SPEED:.0f} ticks/s, lag 80 ms"
    figure.suptitle(f"the compiled firmware on an {board.mcu} in simavr; {motors}", fontsize="medium")
    figure.savefig(path, dpi=100)


def _draw_steps(axes: Axes, results: Results) -> None:
    for target, curve in results.steps.items():
        axes.plot([0.0, STEP_SECONDS, STEP_SECONDS, curve[-1][0]], [target, target, -target, -target], ":", color=FAINT)
        axes.plot(*zip(*curve, strict=True), color=INK)
    axes.plot([], [], ":", color=FAINT, label="asked for")
    axes.plot([], [], color=INK, label="true")
    axes.legend()
    axes.set(xlabel="s", ylabel="ticks/s", title="speed, step response")


def _draw_steady(axes: Axes, results: Results) -> None:
    for (name, rows), colour in zip(results.steady.items(), (INK, FAINT, WARM), strict=True):
        axes.semilogx(SPEEDS, [ripple for _, ripple in rows], "o-", markersize=4, color=colour, label=name)
        axes.semilogx(SPEEDS, [abs(error) for error, _ in rows], "x", color=colour)
    axes.semilogx([], [], "x", color=INK, label="mean error, absolute")
    axes.set(xlabel="asked for, ticks/s", ylabel="%", title="held speed: ripple and mean error")
    axes.set_ylim(top=1.6 * axes.get_ylim()[1])  # the legend's room
    axes.legend(title="ripple, by motors", fontsize="small")


def _draw_odometry(axes: Axes, results: Results) -> None:
    for side, (name, colour) in enumerate((("left", INK), ("right", WARM))):
        axes.plot([true[side] for _, true in results.stops], color=colour, label=f"{name}, true")
        counted = [counted[side] for counted, _ in results.stops]
        axes.plot(counted, "o", markersize=5, color=colour, fillstyle="none", label=f"{name}, counted")
    axes.set(xlabel="stops", ylabel="ticks", title=f"odometry: off by {results.worst_odometry} ticks at worst")
    axes.legend()


def main() -> int:
    """Exit code: 0 done, 1 the simulator is missing (said on stderr)."""
    parser = argparse.ArgumentParser(prog="tools/firmware-plot", description=__doc__)
    parser.add_argument("--board", choices=sorted(BOARDS), default="uno")
    parser.add_argument("--out", type=Path, default=Path("out/firmware.png"), metavar="FILE")
    options = parser.parse_args()
    board = BOARDS[options.board]
    try:
        results = measure(board)
        print(table(results))
        options.out.parent.mkdir(parents=True, exist_ok=True)
        draw(results, board, options.out)
    except (ToolsMissing, BuildError, OSError) as error:
        print(f"tools/firmware-plot: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
