"""Every table and figure that is reproduced, in the thesis' order."""

from __future__ import annotations

from tools.reproduction import compass, continuous, discrete, docking, mirrors, slam, slam_experiments
from tools.reproduction.item import Item

# Items of one group may share measurements, and are made in one process.
GROUPS: tuple[tuple[Item, ...], ...] = (
    compass.ITEMS,
    mirrors.ITEMS,
    slam_experiments.ITEMS,
    slam.ITEMS,
    discrete.ITEMS,
    continuous.ITEMS,
    docking.ITEMS,
)
ITEMS = tuple(item for group in GROUPS for item in group)
