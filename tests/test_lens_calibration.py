"""From a folder of pictures to a file that the daemon reads, or to a sentence and no file."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from omnibotd.core.calibration.chessboard import Board
from omnibotd.io.camera import load_calibration
from omnibotd.lens_calibration import LensCalibrationError, main, write
from tests.chessboards import Lens, drawn, placed

REAL = Path(__file__).parents[2] / "shared/data/fisheye_chessboard"
LENS = Lens.fitting(480, 400, 185, "webcam")
# The camera's axes (u right, v down, optical axis) from the base's (x image top, y image right, z up).
CAMERA_FROM_BASE = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def _ring(zenith: float) -> np.ndarray:
    """Rays in the camera's axes."""
    headings = np.arange(0.0, 2.0 * math.pi, 0.1)
    across = math.sin(zenith)
    return np.column_stack(
        [across * np.cos(headings), across * np.sin(headings), np.full(len(headings), math.cos(zenith))]
    )


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight views of a 6 x 4 board, one picture without, a larger picture, and a file that is none."""
    folder = tmp_path_factory.mktemp("pictures")
    rng, board = np.random.default_rng(0), Board(6, 4)
    for number in range(1, 9):
        image = drawn(LENS, board, placed(LENS, board, rng, 1.25, least_span=0.8), rng)
        cv2.imwrite(str(folder / f"{number}.png"), image)
    cv2.imwrite(str(folder / "9.png"), np.full((400, 480), 90, np.uint8))
    cv2.imwrite(str(folder / "10.png"), cv2.resize(cv2.imread(str(folder / "1.png")), (600, 500)))
    (folder / "11.jpg").write_bytes(b"no picture")
    return folder


def _told(capsys: pytest.CaptureFixture[str]) -> list[dict[str, object]]:
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_writes_what_the_daemon_reads(pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "camera.yaml"
    assert main(["--images", str(pictures), "--square", "0.03", "--out", str(out), "--json"]) == 0
    *each, last = _told(capsys)
    assert [line["image"] for line in each] == [*(f"{k}.png" for k in range(1, 11)), "11.jpg"]
    assert [line["found"] for line in each] == [True] * 8 + [False, True, False]
    model, rays = load_calibration(out), _ring(math.radians(75))
    assert np.hypot(*(model.project(rays @ CAMERA_FROM_BASE) - LENS.project(rays)).T).max() < 2.0
    facts = yaml.safe_load(out.read_text("utf-8"))
    assert last == {"done": facts}
    assert facts["board"] == "6x4"
    assert facts["square_m"] == 0.03
    assert facts["images"] == str(pictures)
    assert facts["rms_px"] < 0.35
    assert facts["dropped"] == {"10.png": "is of 600x500 pixels"}
    assert set(facts["views"]) == {f"{k}.png" for k in range(1, 9)}
    assert facts["field_of_view_deg"] == pytest.approx(180, abs=8)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--board", "9x6"], "has 6x4 inner corners, not 9x6"),
        (["--board", "5x4"], "--board 6x4"),
        (["--board", "nine"], "expected COLUMNSxROWS"),
    ],
)
def test_a_wrong_board_is_told_and_the_file_before_stays(
    arguments: list[str], says: str, pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    few, out = tmp_path / "few", tmp_path / "camera.yaml"
    few.mkdir()
    for k in (1, 2, 3):
        shutil.copy(pictures / f"{k}.png", few)
    out.write_text("before")
    assert main(["--images", str(few), "--out", str(out), *arguments]) == 1
    assert says in capsys.readouterr().err
    assert out.read_text() == "before"


def test_too_few_views_write_nothing(pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for k in (1, 2, 9):
        shutil.copy(pictures / f"{k}.png", tmp_path)
    assert main(["--images", str(tmp_path), "--out", str(tmp_path / "camera.yaml")]) == 1
    told = capsys.readouterr()
    assert "1.png: a chessboard of 6x4 inner corners" in told.out
    assert "9.png: no chessboard" in told.out
    assert "Only 2 different views" in told.err
    assert not (tmp_path / "camera.yaml").exists()


@pytest.mark.parametrize(
    ("content", "says"), [([], "holds no pictures"), (["a.png"], "No chessboard in any of 1 pictures")]
)
def test_a_folder_without_boards(
    content: list[str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in content:
        cv2.imwrite(str(tmp_path / name), np.full((300, 400), 90, np.uint8))
    assert main(["--images", str(tmp_path), "--out", str(tmp_path / "camera.yaml")]) == 1
    assert says in capsys.readouterr().err


def test_what_cannot_be_read_or_written(pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--images", str(tmp_path / "nowhere"), "--out", str(tmp_path / "camera.yaml")]) == 1
    assert "nowhere: can't be read: No such file" in capsys.readouterr().err
    assert main(["--images", str(pictures), "--out", str(tmp_path / "nowhere" / "camera.yaml")]) == 1
    assert "no such folder" in capsys.readouterr().err
    with pytest.raises(LensCalibrationError, match="can't be written: Is a directory"):
        write(tmp_path, {})


@pytest.mark.skipif(not REAL.is_dir(), reason=f"needs the real views in {REAL}")
def test_the_real_views(tmp_path: Path) -> None:
    """All 26 found, 0.35 px rms at most, within 3 px of the reference (Mei's model) to 80 degrees off axis."""
    out = tmp_path / "camera.yaml"
    command = [sys.executable, "-m", "omnibotd.lens_calibration", "--images", str(REAL), "--out", str(out)]
    subprocess.run(command, check=True, capture_output=True, timeout=50)
    facts = yaml.safe_load(out.read_text("utf-8"))
    assert set(facts["views"]) == {f"{k}.jpg" for k in range(1, 27)}
    assert facts["dropped"] == {}
    assert facts["rms_px"] <= 0.35
    model = load_calibration(out)
    for zenith in np.radians([10, 20, 30, 40, 50, 60, 70, 80]):
        rays = _ring(zenith)
        assert np.hypot(*(model.project(rays @ CAMERA_FROM_BASE) - _reference(rays)).T).max() < 3.0


def _reference(rays: np.ndarray) -> np.ndarray:
    """Mei and Rives 2007: onto the unit sphere, moved along its axis, distorted, into the pinhole."""
    reference = yaml.safe_load((REAL / "fisheye.yaml").read_text("utf-8"))
    pinhole, (k1, k2) = reference["pinhole"], reference["radial_tangential"]["radial"]
    x, y = (rays[:, :2] / (rays[:, 2:] + reference["mirror_offset"])).T
    r2 = x * x + y * y
    stretch = 1.0 + k1 * r2 + k2 * r2 * r2
    return np.column_stack([pinhole["fx"] * x * stretch + pinhole["cx"], pinhole["fy"] * y * stretch + pinhole["cy"]])
