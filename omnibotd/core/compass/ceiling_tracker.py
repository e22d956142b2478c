"""Where the robot is, and how it is turned, by what is overhead: a few key views, each frame against the nearest."""

from __future__ import annotations

from dataclasses import dataclass

from omnibotd.core.compass.alignment import Expected
from omnibotd.core.compass.key_layer import NOT_SEEN, Fix
from omnibotd.core.compass.key_view import KeyView, Look, Looking
from omnibotd.core.geometry import Pose2D, wrap
from omnibotd.core.vision.camera_model import CameraModel
from omnibotd.core.vision.frame import Frame

# A new key view this far from all others, in heights of the ceiling: beyond, errors of nearness begin to tell.
_APART = 0.25
# And where the one in use is recognised, but only just: other lamps, or things that move.
_WORN = 0.85
# So many cover 6 x 6 m under a low ceiling, in 13 MB; the farthest goes first.
_MOST_VIEWS = 100
# Frames in a row that match nothing before a new key view is begun: somebody passing by is none of it.
_PATIENCE = 3
# How far a pose may be off that a view was taken at, or took over at (m).
_DOUBT = 0.002
# Without a step nearly nothing is known of where it is (heights, rad), and the height is what it is.
_ANYWHERE, _ANY_TURN, _HEIGHT_SET = 0.1, 0.1, 1e-4
# Another view takes over where it is so much nearer than the one in use, and agrees with it (heights, rad).
_NEARER, _AGREES, _AGREES_TURN = 0.8, 0.03, 0.02


@dataclass(frozen=True, slots=True)
class Step:
    """How the robot moved since the last frame by other senses, and how far that may be off (m, rad): lengths always by
    the same share, turns at random."""

    moved: Pose2D
    shift: float
    turn: float


@dataclass(frozen=True, slots=True)
class Tracked:
    """Pose in the frame in which tracking began; not `seen`: carried on from the last by what was expected."""

    pose: Pose2D
    seen: bool
    score: float


class CeilingTracker:
    """Follows one robot. Errors add up from key view to key view, and not at all where it has been before."""

    def __init__(self, camera: CameraModel, height: float, height_error: float = 0.2) -> None:
        """`height`: m from camera to ceiling, which may be wrong by the share `height_error`.

        Where steps say how far the robot moved, they say how long a metre is; without, the height does.
        """
        self._looking = Looking(camera)
        self._height, self._height_error = height, height_error
        self._views: list[KeyView] = []
        self._view: KeyView | None = None  # the one in use
        self._missed = 0  # frames since the last that was recognised
        self._pose = Pose2D()
        self._last_move = Pose2D()
        # By steps and the heading seen, since the view in use took over; and how far that may be off by now (m).
        self._reckoned, self._doubt = Pose2D(), _DOUBT

    def update(self, frame: Frame, step: Step | None = None) -> Tracked:
        """Take the next frame; without a step it is expected to move as it did last. FrameError: unusable frame."""
        look = self._looking(frame)
        moved = self._last_move if step is None else step.moved
        predicted = self._pose @ moved
        if step is not None:
            self._reckon(step)
        fix = self._fixed(look, predicted, step)
        seen = self._view is not None and fix.good
        here = self._view.pose @ fix.pose if self._view is not None and seen else predicted
        self._last_move, self._pose = self._pose.inverse() @ here, here
        self._missed = 0 if seen else self._missed + 1
        self._remember(frame, fix.score)
        return Tracked(here, seen, fix.score)

    def _reckon(self, step: Step) -> None:
        along = Pose2D(self._reckoned.x, self._reckoned.y, self._pose.yaw) @ step.moved
        self._reckoned, self._doubt = along, self._doubt + step.shift

    def _use(self, view: KeyView, here: Pose2D) -> None:
        self._view, self._reckoned, self._doubt = view, here, _DOUBT

    def _fixed(self, look: Look, predicted: Pose2D, step: Step | None) -> Fix:
        """Against the view in use; against the one nearest to where that puts us, where that one is better."""
        fix = self._against(self._view, look, predicted, step, learn=True)
        here = self._view.pose @ fix.pose if self._view is not None and fix.good else predicted
        other = min(self._views, key=lambda view: view.pose.distance(here), default=None)
        if other is None or other is self._view or (fix.good and not self._nearer(other, here)):
            return fix
        second = self._against(other, look, here, step, learn=False)
        if second.good and (not fix.good or self._agree(other.pose @ second.pose, here)):
            self._use(other, other.pose @ second.pose)
            return second
        return fix

    def _against(self, view: KeyView | None, look: Look, predicted: Pose2D, step: Step | None, *, learn: bool) -> Fix:
        if view is None:
            return NOT_SEEN
        start = view.pose.inverse() @ predicted
        if step is None:
            expected = Expected(start, start, _ANYWHERE * self._height, _ANY_TURN, self._height, _HEIGHT_SET)
        else:
            pose = view.pose.inverse() @ Pose2D(self._reckoned.x, self._reckoned.y, predicted.yaw)
            expected = Expected(start, pose, self._doubt, step.turn, self._height, self._height_error)
        return view.locate(look, expected, learn=learn)

    def _nearer(self, other: KeyView, here: Pose2D) -> bool:
        return self._view is None or other.pose.distance(here) < _NEARER * self._view.pose.distance(here)

    def _agree(self, one: Pose2D, other: Pose2D) -> bool:
        return one.distance(other) < _AGREES * self._height and abs(wrap(one.yaw - other.yaw)) < _AGREES_TURN

    def _wanting(self, view: KeyView, score: float) -> bool:
        if self._missed:
            return self._missed >= _PATIENCE
        return score < _WORN or view.pose.distance(self._pose) > _APART * self._height

    def _remember(self, frame: Frame, score: float) -> None:
        """Make this a key view where none is near, or none of them is recognised any more."""
        if self._view is not None and not self._wanting(self._view, score):
            return
        view = KeyView.of(frame, self._looking, self._pose)
        if view is None:
            return
        if self._view is not None and self._missed == 0:
            view.inherit(self._view, self._height)
        self._use(view, self._pose)
        self._missed = 0
        self._views.append(view)
        if len(self._views) > _MOST_VIEWS:
            self._views.remove(max(self._views, key=lambda each: each.pose.distance(self._pose)))
