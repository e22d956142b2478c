"""What to tell about a job's end: what was seen, what was expected, where the robot believes to be."""

from __future__ import annotations

import math
from collections.abc import Mapping

from omnibotd.core.decision import Observation
from omnibotd.core.geometry import Pose2D
from omnibotd.core.navigation.certainty import SURE, Certainty


def report(
    certainty: Certainty, seen: Observation, here: Pose2D | None, **more: float | None
) -> Mapping[str, float | str]:
    """Metres, radians, seconds; what is not known is left out."""
    seconds, metres = certainty.since_sure(seen)
    told: dict[str, float | None] = {"seconds_since_sure": seconds, "metres_since_sure": metres, **more}
    if certainty.latest is not None:
        latest = certainty.latest
        told |= {"confidence": latest.confidence, "score": latest.score, "margin": latest.margin}
        told |= {"sigma": latest.sigma, "node": latest.node}
    told["expected_confidence"] = SURE
    if certainty.sure is not None:
        told |= {"expected_score": certainty.sure.score, "expected_node": certainty.sure.node}
    if here is not None:
        told |= {"x": here.x, "y": here.y, "yaw": here.yaw}
    return {name: round(value, 3) for name, value in told.items() if value is not None and math.isfinite(value)}
