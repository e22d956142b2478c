"""What the core refuses, and why."""

from __future__ import annotations


class CoreError(Exception):
    """Base of all errors of the core; the message says what was wrong, where, and what to do."""


class FrameError(CoreError):
    """An image that can't be decoded or has another size than the camera model's."""


class MapError(CoreError):
    """A map or recording that can't be used."""


class TrainingError(CoreError):
    """A recording from which no map can be made."""
