"""From figures to what is wrong: where each grade begins, and that what is not well comes with a remedy."""

import pytest

from omnibotd import findings
from omnibotd.findings import Finding, Grade, from_values


@pytest.mark.parametrize(
    ("finding", "grade"),
    [
        (findings.frame_rate(14.8, 15.0), Grade.OK),
        (findings.frame_rate(9.9, 15.0), Grade.WARNING),
        (findings.frame_rate(3.0, 15.0), Grade.WRONG),
        (findings.picture(110.0, 40.0, 0.1), Grade.OK),
        (findings.picture(12.0, 9.0, 0.0), Grade.WARNING),  # night
        (findings.picture(220.0, 50.0, 0.6), Grade.WARNING),  # a window
        (findings.picture(5.0, 1.0, 0.0), Grade.WRONG),  # the cap is on
        (findings.disk(20e9, "/d"), Grade.OK),
        (findings.disk(5e8, "/d"), Grade.WARNING),
        (findings.disk(5e7, "/d"), Grade.WRONG),
        (findings.clock(1.8e9, 1.7e9, True), Grade.OK),
        (findings.clock(1.8e9, 1.7e9, False), Grade.WARNING),
        (findings.clock(1.8e9, 1.7e9, None), Grade.UNKNOWN),
        (findings.clock(0.0, 1.7e9, True), Grade.WRONG),
        (findings.loop(0.004, 0.009), Grade.OK),
        (findings.loop(0.04, 0.09), Grade.WARNING),
        (findings.loop(0.12, 0.3), Grade.WRONG),
        (findings.processor(0.3, 0.1), Grade.OK),
        (findings.processor(0.95, None), Grade.WARNING),
        (findings.memory(5e8), Grade.OK),
        (findings.memory(5e7), Grade.WARNING),
    ],
)
def test_grades(finding: Finding, grade: Grade) -> None:
    assert finding.grade is grade
    assert bool(finding.remedy) == (grade in (Grade.WARNING, Grade.WRONG))


def test_a_dirty_lens_is_named_and_a_clean_one_is_not() -> None:
    finding = findings.dirt(0.08)
    assert finding is not None
    assert (finding.grade, finding.remedy) == (Grade.WARNING, "wipe the lens")
    assert "8%" in finding.found
    assert findings.dirt(0.004) is None


def test_a_kernels_name_is_warned_of_only_where_there_is_a_better_one() -> None:
    better = "/dev/serial/by-id/usb-FTDI"
    finding = findings.stable_name("base", "base.port", "/dev/ttyUSB0", better)
    assert finding is not None
    assert finding.remedy == f"set base.port: {better}"
    assert findings.stable_name("base", "base.port", "/dev/ttyUSB0", None) is None
    assert findings.stable_name("base", "base.port", better, better) is None


def test_findings_survive_the_socket() -> None:
    sent = [findings.ok("disk", "fine"), findings.wrong("base", "gone", "plug it in")]
    assert from_values([finding.values() for finding in sent]) == sent
