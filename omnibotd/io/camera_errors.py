"""The one error of all frame sources."""


class CameraError(Exception):
    """A source of frames that can't be opened or has stopped; the message says why and what to do."""
