"""Methods by name: the parts that make a map and those that find the way in it.

A map is always used by the method that made it, whatever the configuration says by then.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib import import_module
from typing import Protocol, cast

from omnibotd.core.errors import MapError
from omnibotd.core.geometry import Pose2D
from omnibotd.core.jobs import Job
from omnibotd.core.mapping.drive import TeachingSample
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.navigation.goal_filter import GoalFilter
from omnibotd.core.navigation.localization import Localizer
from omnibotd.core.navigation.navigator import Navigator, Tolerance
from omnibotd.core.percept import PlaceEstimate
from omnibotd.core.safety import Limits
from omnibotd.core.thesis.localizer import ThesisLocalizer
from omnibotd.core.thesis.navigator import ThesisNavigator
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame


class Locating(Protocol):
    """Says where in its map a frame was taken."""

    def update(self, frame: Frame, odom_from_base: Pose2D) -> PlaceEstimate:
        """Take the next frame and the odometry at its stamp. CoreError where the frame can't be used."""

    def reset(self) -> None:
        """Forget where the robot was."""


class Training(Protocol):
    """Makes a map of a teaching drive; TrainingError where none can be made."""

    def __call__(
        self,
        name: str,
        samples: Iterable[TeachingSample],
        camera: CameraModel,
        *,
        seed: int = 0,
        progress: Callable[[str, float], None],
    ) -> TopoMap: ...


# (topo_map, goal, goal_filter, limits, tolerance, robot_radius, period)
MakeNavigator = Callable[[TopoMap, Pose2D, GoalFilter, Limits, Tolerance, float, float], Job]


@dataclass(frozen=True, slots=True)
class Preset:
    """The parts of one method; `trainer` is MODULE:FUNCTION, loaded only where training happens."""

    localizer: Callable[[TopoMap, CameraModel], Locating]
    navigator: MakeNavigator
    trainer: str


PRESETS = {
    "default": Preset(Localizer, Navigator, "omnibotd.core.mapping.training:train"),
    "thesis": Preset(ThesisLocalizer, ThesisNavigator, "omnibotd.core.thesis.training:train_thesis"),
}


def preset_of(topo_map: TopoMap) -> Preset:
    """The method that can use this map. MapError where this omnibotd has none such."""
    if topo_map.method not in PRESETS:
        raise MapError(
            f"map {topo_map.name!r} was made by method {topo_map.method!r}, this omnibotd has "
            f"{', '.join(PRESETS)}: train it again, or upgrade"
        )
    return PRESETS[topo_map.method]


def load_trainer(preset: str) -> Training:
    """The training of a method. Its imports (scipy) are for the training process only."""
    module, _, function = PRESETS[preset].trainer.partition(":")
    return cast(Training, getattr(import_module(module), function))
