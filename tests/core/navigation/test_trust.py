"""Trust in the tracked pose: what earns it and what takes it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from omnibotd.core.navigation.certainty import SURE
from omnibotd.core.navigation.sight import Sight, expected_score
from omnibotd.core.navigation.trust import Trust, calibrated

CHANCE = 0.5
GOOD = Sight(score=0.86, elsewhere=0.3, unexplained=0.04, moved=0.03)


def sure() -> Trust:
    trust = Trust(CHANCE)
    for _ in range(60):
        trust.update(GOOD)
    return trust


def frames_until(trust: Trust, sight: Sight, below: float) -> int:
    for number in range(1, 200):
        if trust.update(sight) < below:
            return number
    return 200


def test_two_metres_of_agreement_convince() -> None:
    assert sure().value > 0.99


def test_one_frame_does_not() -> None:
    assert Trust(CHANCE).update(GOOD) < 0.8


def test_look_alikes_do_not_convince_at_rest() -> None:
    trust = Trust(CHANCE)
    alike = replace(GOOD, score=CHANCE, elsewhere=CHANCE - 0.05, moved=0.0)
    for _ in range(100):
        trust.update(alike)
    assert trust.value < 0.1


def test_a_better_place_elsewhere_contradicts_at_once() -> None:
    assert frames_until(sure(), replace(GOOD, score=0.4, elsewhere=0.85), 0.3) <= 2


def test_a_view_that_breaks_off_is_doubted_in_the_same_frame() -> None:
    trust = sure()
    carried = replace(GOOD, score=0.05, elsewhere=0.4, moved=0.0, continues=False)
    assert trust.update(carried) < 0.05
    assert trust.broken


def test_an_uncovered_lens_is_believed_again() -> None:
    trust = sure()
    trust.update(replace(GOOD, score=0.0, elsewhere=0.3, moved=0.0, continues=False))
    assert trust.update(replace(GOOD, continues=False)) > 0.5


def test_where_it_was_carried_trust_is_earned_anew() -> None:
    """Half-way between nodes no match is good enough to settle the matter, but a metre of agreement is."""
    trust = sure()
    fair = replace(GOOD, score=0.62, elsewhere=0.5, unexplained=0.4)
    assert trust.update(replace(fair, continues=False, moved=0.0)) < 0.5
    for _ in range(60):
        trust.update(fair)
    assert not trust.broken
    assert trust.value > 0.6


def test_beside_the_nodes_a_poor_match_costs_metres_not_frames() -> None:
    poor = replace(GOOD, score=0.2, elsewhere=0.2, unexplained=0.9, moved=0.0)
    assert frames_until(sure(), poor, 0.9) == 200
    assert 30 < frames_until(sure(), replace(poor, moved=0.03), 0.6) < 100


@pytest.mark.parametrize(("unexplained", "least", "most"), [(0.04, 0.82, 0.88), (0.27, 0.68, 0.79), (1.0, 0.0, 0.0)])
def test_less_is_expected_farther_from_the_nodes(unexplained: float, least: float, most: float) -> None:
    """Medians measured: 0.85-0.88 at the nodes, 0.68-0.79 about 0.2 m off."""
    assert least <= expected_score(unexplained) <= most


def test_confidence_grows_with_belief_and_is_held_back_where_places_look_alike() -> None:
    beliefs = [0.0, 0.01, 0.3, 0.6, 0.9, 0.99, 1.0]
    unique, repetitive = ([calibrated(belief, chance) for belief in beliefs] for chance in (0.45, 0.9))
    assert unique == sorted(unique)
    assert repetitive == sorted(repetitive)
    assert all(a >= b for a, b in zip(unique, repetitive, strict=True))
    assert repetitive[3] < SURE < unique[3]
    assert (unique[0] < 0.01, unique[-1] > 0.99) == (True, True)


def test_in_the_dark_less_likeness_is_enough_once_metres_agree() -> None:
    """By night a right pose correlates at 0.55, everything else at 0.2 or less: believed after some metres."""
    dark = replace(GOOD, score=0.55, elsewhere=0.2, moved=0.03)
    trust = Trust(CHANCE)
    assert max(trust.update(dark) for _ in range(10)) < 0.3
    for _ in range(150):
        trust.update(dark)
    assert trust.value > 0.9


def test_a_match_that_others_come_near_is_no_matter_of_the_light() -> None:
    """Outside the map its rim looks like this, by day."""
    rim = replace(GOOD, score=0.55, elsewhere=0.4, moved=0.03)
    trust = Trust(CHANCE)
    for _ in range(400):
        trust.update(rim)
    assert trust.value < 0.3
    assert trust.light.share == 1.0


def test_metres_on_which_odometry_is_followed_teach_a_darker_light() -> None:
    """Lamps off under metal panels: a right pose correlates at 0.4, the best elsewhere at 0.2."""
    dim = replace(GOOD, score=0.4, elsewhere=0.2, moved=0.03, corrected=0.001)
    trust = Trust(CHANCE)
    assert max(trust.update(dim) for _ in range(20)) < 0.3
    for _ in range(250):
        trust.update(dim)
    assert trust.value > 0.9


def test_a_pose_that_does_not_follow_odometry_teaches_no_darker_light() -> None:
    """The like of it half a turn round wanders by a decimetre in a metre."""
    wandering = replace(GOOD, score=0.4, elsewhere=0.2, moved=0.03, corrected=0.03)
    trust = Trust(CHANCE)
    for _ in range(400):
        trust.update(wandering)
    assert trust.light.share == 1.0
    assert trust.value < 0.3


def after(frames: int, sight: Sight, chance: float = CHANCE) -> float:
    """The trust that so many frames alike have earned."""
    trust = Trust(chance)
    for _ in range(frames):
        trust.update(sight)
    return trust.value


def test_walls_that_fit_teach_another_light_where_a_small_lead_alone_does_not() -> None:
    """Lamps off in the same office: walls correlate at 0.6 to 0.85; 2.5 m."""
    dim = replace(GOOD, score=0.4, elsewhere=0.26, moved=0.03)
    assert after(80, replace(dim, rim=0.75)) > 0.9
    assert after(80, dim) < 0.1


def test_a_ceiling_that_fits_without_its_walls_is_another_half_of_the_room() -> None:
    """Measured half a turn round in a gallery of which one half was taught: 0.7, where 0.87 is expected."""
    alike = replace(GOOD, score=0.7, elsewhere=0.55)
    assert after(400, replace(alike, rim=0.05)) < 0.05
    assert after(400, replace(alike, rim=0.75)) > 0.9


def test_a_whole_that_fits_needs_no_walls() -> None:
    """A cupboard was moved, people stand all around."""
    assert after(60, replace(GOOD, rim=0.2)) > 0.9


def test_walls_tell_identical_lamps_apart() -> None:
    """Measured in a hall of lamps every 1.8 m: under the right one the walls correlate at 0.86, under others at 0.5."""
    hall = replace(GOOD, score=0.88, elsewhere=0.82)
    assert after(8, replace(hall, rim=0.86), 0.81) > 0.9
    assert after(8, hall, 0.81) < 0.5


def test_under_the_wrong_one_of_identical_lamps_the_whole_fits_and_is_not_believed() -> None:
    """Measured in halls: there the walls correlate at 0.64 at most."""
    assert after(400, replace(GOOD, score=0.86, elsewhere=0.79, rim=0.6), 0.85) < 0.05


def test_when_the_lamps_come_on_again_the_dark_is_forgotten() -> None:
    trust = Trust(CHANCE)
    for _ in range(200):
        trust.update(replace(GOOD, score=0.5, elsewhere=0.1, moved=0.03))
    assert trust.light.share < 0.7
    for _ in range(40):
        trust.update(replace(GOOD, moved=0.03))
    assert trust.light.share > 0.95


def test_rows_of_lamps_that_are_off_make_no_places_look_alike() -> None:
    """Measured in a workshop by night: rows of alike lamps while it was taught, then only its walls are to be seen."""
    dark = replace(GOOD, score=0.38, elsewhere=0.19, rim=0.69)
    assert after(250, dark, 0.76) > 0.9
    assert after(250, replace(dark, elsewhere=0.33), 0.76) < 0.05
