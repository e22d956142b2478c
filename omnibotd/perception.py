"""Frames in, estimates out: one frame at a time, on a worker thread, over an immutable snapshot of the map."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Any

import numpy as np

from omnibotd.config import Config
from omnibotd.control import ControlLoop
from omnibotd.core.compass.sighted_odometry import Sight, SightedOdometry, sight
from omnibotd.core.decision import HomingRequest
from omnibotd.core.docking.lights import Light, Lights
from omnibotd.core.errors import CoreError, MapError
from omnibotd.core.geometry import Pose2D
from omnibotd.core.mapping.calibration import calibration_differs
from omnibotd.core.mapping.topo_map import Dock, TopoMap
from omnibotd.core.percept import HomingEstimate
from omnibotd.core.vision import image_circle
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame
from omnibotd.io.camera import Camera, load_calibration
from omnibotd.presets import Locating, preset_of

log = logging.getLogger(__name__)

BUSY_PERIOD = 0.1  # s between frames looked at while something moves: the control tick's own
IDLE_PERIOD = 0.5  # s at rest; an idle robot should leave the processor alone
CIRCLE_FRAMES = 5  # frames in which the image circle is looked for; noise differs, the circle does not
DEFAULT_CEILING = 2.2  # m from camera to ceiling where neither the map nor the configuration knows better
# How far the ceiling may be from there, and from where the configuration has it (shares): lamps and beams hang lower.
UNMEASURED, MEASURED = 0.3, 0.03

OffLoop = Callable[..., Awaitable[Any]]


class Perception:
    """Looks at frames for the control loop: place in the map, homing to a dock, and frames for the recording."""

    def __init__(self, config: Config, control: ControlLoop, camera: Camera, off_loop: OffLoop) -> None:
        self._config, self._control, self._camera, self._off_loop = config, control, camera, off_loop
        self.model: CameraModel | None = None
        self.lens_known = asyncio.Event()
        self.topo_map: TopoMap | None = None
        self._localizer: Locating | None = None
        self._edited: TopoMap | None = None  # the last edit since `use` was called last
        self._registration: tuple[str, Lights] | None = None
        self._sight: Sight | None = None
        self._sighted_at: Pose2D | None = None  # by the wheels
        self._recorded_at = -math.inf
        self._first_frames: list[Frame] = []
        self.reason = ""
        self.witness: Callable[[Frame, Pose2D], None] | None = None  # is shown every frame with its odometry
        self.loading: str | None = None  # the map that is being made ready: no job may start on the one before

    async def use(self, topo_map: TopoMap | None) -> None:
        """Work with this map from the next frame on. Raises CoreError where it does not fit the camera."""
        localizer, self._edited = None, None
        if topo_map is not None and self.model is not None:
            self.loading = topo_map.name
            try:
                localizer = await self.localizer_of(topo_map, self.model)
            finally:
                self.loading = None
            # Making it ready took seconds on a slow PC; places that were named meanwhile must not be lost.
            if self._edited is not None and _same_nodes(self._edited, topo_map):
                topo_map = self._edited
        self.topo_map, self._localizer, self._registration = topo_map, localizer, None
        self._control.forget_pose()

    async def localizer_of(self, topo_map: TopoMap, model: CameraModel) -> Locating:
        """One of its own for this map, by the map's method. MapError where the camera is not the one taught with."""
        if sentence := calibration_differs(topo_map, model):
            raise MapError(sentence)
        made: Locating = await self._off_loop(preset_of(topo_map).localizer, topo_map, model)
        return made

    async def relocalise(self) -> None:
        """Forget where the robot was; the next frame is looked up in the whole map."""
        if self._localizer is not None:
            await self._off_loop(self._localizer.reset)  # on the worker, where no update can be half done
        self._control.forget_pose()

    def edited(self, topo_map: TopoMap) -> None:
        """The same nodes with other places or docks: the pose stays."""
        self.topo_map, self._registration, self._edited = topo_map, None, topo_map

    async def run(self) -> None:
        """Look at the newest frame, then rest until the next is due; never more than one frame in flight."""
        stamp = -math.inf
        while True:
            frame = await self._camera.wait_newer(stamp)
            stamp = frame.stamp
            began = asyncio.get_running_loop().time()
            await self._look(frame)
            busy = self._control.moving or self._control.recorder or self.witness
            period = BUSY_PERIOD if busy else IDLE_PERIOD
            # A little less than the period, or a camera of the same rate would lose every other frame to jitter.
            await asyncio.sleep(max(0.0, began + 0.8 * period - asyncio.get_running_loop().time()))

    async def _look(self, frame: Frame) -> None:
        try:
            self._control.absorb()
            if self._sight is not None:
                await self._correct_odometry(self._sight, frame)
            odom_from_base = self._control.odometry.at(frame.stamp)
            if self.witness is not None:  # wheels are calibrated, too
                self.witness(frame, self._control.wheels.at(frame.stamp))
            if self.model is None:
                await self._learn_camera(frame)
            if self._control.recorder is not None:
                await self._record(frame, odom_from_base)
            await self._estimate(frame, odom_from_base)
            self.reason = ""
        except CoreError as error:
            if str(error) != self.reason:  # once, not ten times a second
                log.warning("frame not used: %s", error)
            self.reason = str(error)

    async def _correct_odometry(self, sight: Sight, frame: Frame) -> None:
        """By what the frame shows, unless the base stands still: that tells nothing new, ten times a second."""
        by_wheels = self._control.wheels.at(frame.stamp)
        if by_wheels == self._sighted_at:
            return
        seen = await self._off_loop(sight.update, frame, by_wheels)
        self._sighted_at = by_wheels
        odometry = self._control.odometry
        if isinstance(odometry, SightedOdometry):
            odometry.correct(seen, by_wheels)

    def _sight_for(self, model: CameraModel) -> Sight:
        settings, height = self._config.odometry, self._config.docking.ceiling_height
        error = UNMEASURED if height is None else MEASURED
        return sight(settings.heading, settings.compass, model, height or DEFAULT_CEILING, error)

    async def _learn_camera(self, frame: Frame) -> None:
        """The lens from the calibration file, else from the image circle found in the first frames."""
        self._first_frames.append(frame)
        settings = self._config.camera
        fov = math.radians(settings.fov_deg)
        if settings.calibration is not None:
            model = load_calibration(settings.calibration, fov)
        elif settings.radius is not None and settings.centre is not None:
            height, width = frame.grey().shape
            model = CameraModel.equidistant(width, height, fov, settings.radius, settings.centre)
        elif len(self._first_frames) < CIRCLE_FRAMES:
            return
        else:
            model = await self._off_loop(find_lens, self._first_frames, fov)
        if settings.centre is not None:
            model = replace(model, cx=settings.centre[0], cy=settings.centre[1])
        self.model = replace(model, mount_yaw=settings.mount_yaw, tilt=settings.tilt)
        if self._config.odometry.heading != "wheels":
            self._sight = await self._off_loop(self._sight_for, self.model)
        self.lens_known.set()
        self._first_frames = []
        log.info(
            "camera %dx%d, f %.1f px, centre (%.1f, %.1f)",
            model.width,
            model.height,
            model.fx,
            model.cx,
            model.cy,
        )
        try:
            await self.use(self.topo_map)
        except CoreError as error:
            log.error("going on without a map: %s", error)
            await self.use(None)

    async def _record(self, frame: Frame, odom_from_base: Pose2D) -> None:
        if frame.stamp - self._recorded_at < 0.9 / self._config.recording.frame_rate:
            return
        self._recorded_at = frame.stamp
        jpeg = await self._off_loop(frame.jpeg)
        if self._control.recorder is not None:  # it may have been closed meanwhile
            self._control.recorder.frame(frame.stamp, odom_from_base, jpeg)

    async def _estimate(self, frame: Frame, odom_from_base: Pose2D) -> None:
        localizer, request = self._localizer, self._control.homing_request
        if localizer is not None and request is None:
            place = await self._off_loop(localizer.update, frame, odom_from_base)
            if localizer is self._localizer:
                self._control.note_place(place)
        if request is not None:
            homing = await self._off_loop(self._home, request, frame, odom_from_base)
            if homing is not None:
                self._control.note_homing(homing)

    def _home(self, request: HomingRequest, frame: Frame, odom_from_base: Pose2D) -> HomingEstimate | None:
        """Runs on the worker: register the frame with the dock's views."""
        registration = self.lights_at(request.dock)
        if registration is None:
            return None
        frame = self.marked(frame)
        if request.dock_from_odom is None:
            return registration.fix(frame, odom_from_base)
        return registration.track(frame, odom_from_base, request.dock_from_odom @ odom_from_base)

    def lights_at(self, dock: str) -> Lights | None:
        """The views of a dock of the map in use, prepared once; on the worker. None without that dock or a lens."""
        topo_map, model = self.topo_map, self.model
        if topo_map is None or model is None or dock not in topo_map.docks:
            return None
        if self._registration is None or self._registration[0] != dock:
            self._registration = (dock, self.lights_of(topo_map, topo_map.docks[dock], model))
        return self._registration[1]

    def marked(self, frame: Frame) -> Frame:
        """The frame, and where the lens is known to be dirty."""
        return frame if self._localizer is None else replace(frame, dirty=self._localizer.dirty)

    @property
    def dirt(self) -> float:
        """Share of the view in which the lens is known to be dirty."""
        dirty = None if self._localizer is None else self._localizer.dirty
        return 0.0 if dirty is None else float(dirty.mean())

    def lights_of(self, topo_map: TopoMap, dock: Dock, model: CameraModel) -> Lights:
        """What registers frames with all views of a dock, by the map's method; on the worker, for it takes its time."""
        homing, ceiling = preset_of(topo_map).homing, self._ceiling(topo_map)
        return Lights(
            [Light(homing(model, Frame(0.0, view.jpeg), ceiling), view.dock_from_base) for view in dock.views]
        )

    def _ceiling(self, topo_map: TopoMap) -> float:
        if self._config.docking.ceiling_height is not None:
            return self._config.docking.ceiling_height
        return topo_map.ceiling_height if math.isfinite(topo_map.ceiling_height) else DEFAULT_CEILING


def _same_nodes(one: TopoMap, other: TopoMap) -> bool:
    return one.name == other.name and np.array_equal(one.poses, other.poses)


def find_lens(frames: list[Frame], fov: float) -> CameraModel:
    """An equidistant lens that fills the image circle seen in the frames, or the smaller side where none is seen."""
    height, width = frames[0].grey().shape
    circle = image_circle.find(frames)
    if circle is None:
        log.warning("no image circle found: taking the lens to fill the %d px of the smaller side", min(width, height))
        return CameraModel.equidistant(width, height, fov)
    cx, cy, radius = circle
    return CameraModel.equidistant(width, height, fov, radius, (cx, cy))
