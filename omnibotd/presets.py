"""Methods by name: the parts that make a map and those that find the way in it.

A map is always used by the method that made it, whatever the configuration says by then.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Protocol, cast

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.decision import Observation
from omnibotd.core.docking.docker import Docker, DockingParameters, staging_pose
from omnibotd.core.docking.registration import DockRegistration
from omnibotd.core.errors import MapError
from omnibotd.core.geometry import Pose2D
from omnibotd.core.jobs import DockingTrip, Job
from omnibotd.core.mapping.drive import TeachingSample
from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.navigation.goal_filter import GoalFilter
from omnibotd.core.navigation.localization import Localizer
from omnibotd.core.navigation.navigator import Navigator, Tolerance
from omnibotd.core.percept import HomingEstimate, PlaceEstimate
from omnibotd.core.safety import Limits
from omnibotd.core.thesis.docking import ThesisHoming
from omnibotd.core.thesis.docking_controller import ThesisDocker, Vicinity
from omnibotd.core.thesis.localizer import ThesisLocalizer
from omnibotd.core.thesis.navigator import ThesisNavigator
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame


class Locating(Protocol):
    """Says where in its map a frame was taken, and which cells of a view the lens' dirt hides, if it finds out."""

    @property
    def dirty(self) -> NDArray[np.bool_] | None: ...

    def update(self, frame: Frame, odom_from_base: Pose2D) -> PlaceEstimate:
        """Take the next frame and the odometry at its stamp. CoreError where the frame can't be used."""

    def reset(self) -> None:
        """Forget where the robot was."""


class Homing(Protocol):
    """Says where the base stood, relative to a dock, when a frame was taken."""

    def fix(self, frame: Frame, odom_from_base: Pose2D) -> HomingEstimate:
        """From nothing. CoreError where the frame can't be used."""

    def track(self, frame: Frame, odom_from_base: Pose2D, prior: Pose2D) -> HomingEstimate:
        """From the dock_from_base expected. CoreError where the frame can't be used."""


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
class DockingTask:
    """Where and how to dock. `goal_filter` has the pose in the map, None where it is not to be relied on; `glance`
    looks, before the robot goes anywhere, whether it stands in the dock already."""

    dock: str
    map_from_dock: Pose2D
    parameters: DockingParameters
    goal_filter: GoalFilter | None = None
    glance: Job | None = None


# (a navigator to a pose, what is to be done)
MakeDocking = Callable[[Callable[[Pose2D], Job], DockingTask], Job]


@dataclass(frozen=True, slots=True)
class Preset:
    """The parts of one method; `trainer` is MODULE:FUNCTION, loaded only where training happens.

    `homing` is made of the camera, the dock's snapshot and the metres from camera to ceiling.
    """

    localizer: Callable[[TopoMap, CameraModel], Locating]
    navigator: MakeNavigator
    trainer: str
    homing: Callable[[CameraModel, Frame, float], Homing]
    docking: MakeDocking


def _from_staging_pose(trip: Callable[[Pose2D], Job], task: DockingTask) -> Job:
    """What has arrived at the staging pose knows where it is: the docker is told."""

    def docker(staged: Observation | None) -> Job:
        made = Docker(task.dock, task.parameters)
        here = None if task.goal_filter is None else task.goal_filter.map_from_base
        if staged is not None and here is not None:
            made.expect(task.map_from_dock.inverse() @ here @ staged.odom_from_base.inverse())
        return made

    trips = 1 + min(task.parameters.max_retries, 1)
    return DockingTrip(partial(trip, staging_pose(task.map_from_dock)), docker, task.glance, trips)


def _from_within_a_metre(trip: Callable[[Pose2D], Job], task: DockingTask) -> Job:
    return DockingTrip(
        lambda: Vicinity(trip(task.map_from_dock)), lambda staged: ThesisDocker(task.dock, task.parameters), task.glance
    )


PRESETS = {
    "default": Preset(
        Localizer, Navigator, "omnibotd.core.mapping.training:train", DockRegistration, _from_staging_pose
    ),
    "thesis": Preset(
        ThesisLocalizer,
        ThesisNavigator,
        "omnibotd.core.thesis.training:train_thesis",
        ThesisHoming,
        _from_within_a_metre,
    ),
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
