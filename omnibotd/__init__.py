"""omnibotd: navigation and docking with one fisheye camera facing the ceiling."""

__version__ = "0.1.0"
