"""The arrays of a map as they lie in its file (MAP_FORMAT.md): rounded, put in order, and as differences."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omnibotd.core.mapping.topo_map import EdgeKind, Edges, TopoMap

DAMAGED = "it is damaged: restore it from a backup, or train it again from its recording"

# Poses are whole tenths of a millimetre and of a milliradian: a hundredth of how well a node is known.
POSE_UNIT = 1e-4
_POSE_LIMIT = 2**31 - 1


class MapFormatError(Exception):
    """The bytes are no map we can use; `section` says where, the message what and what to do."""

    def __init__(self, section: str, message: str) -> None:
        super().__init__(f"section {section!r}: {message}")
        self.section = section


@dataclass(frozen=True, slots=True)
class Layout:
    """An array in the file: its dtype, the lengths behind the first axis (-1 is any), and whether its rows are stored
    as differences from the row before, modulo 2^32: small numbers, which zlib makes a byte or less."""

    dtype: str
    inner: tuple[int, ...] = ()
    differences: bool = False


_NODES = {
    "units": Layout("<u2"),
    "snapshots": Layout("|u1", (-1,)),
    "poses": Layout("<i4", (3,), differences=True),
    "sessions": Layout("<u2"),
}
_EDGES = {
    "edges.first": Layout("<i4", differences=True),
    "edges.second": Layout("<i4", differences=True),
    "edges.kind": Layout("|u1"),
}
LAYOUTS = {"codebook": Layout("<f2", (-1,)), **_NODES, **_EDGES}


def stored(topo_map: TopoMap) -> dict[str, NDArray[Any]]:
    """The arrays of the file by section. MapFormatError for what it can't hold."""
    arrays: dict[str, NDArray[Any]] = {
        "codebook": _halved(topo_map.codebook),
        "units": topo_map.units,
        "snapshots": topo_map.snapshots,
        "poses": _rounded(topo_map.poses),
        "sessions": topo_map.sessions,
        **_ordered(topo_map.edges),
    }
    return {name: _laid_out(array, LAYOUTS[name]) for name, array in arrays.items()}


def restored(arrays: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """The TopoMap's fields from the arrays of the file. MapFormatError where they do not fit together."""
    plain = {name: _summed(array) if LAYOUTS[name].differences else array for name, array in arrays.items()}
    native = {name: array.astype(array.dtype.newbyteorder("="), copy=False) for name, array in plain.items()}
    _check_agreement(native)
    return {
        "codebook": native["codebook"].astype(np.float32),
        "units": native["units"],
        "snapshots": native["snapshots"],
        "poses": (native["poses"] * POSE_UNIT).astype(np.float32),
        "sessions": native["sessions"],
        "edges": Edges(native["edges.first"], native["edges.second"], native["edges.kind"]),
    }


def _halved(codebook: NDArray[np.float32]) -> NDArray[np.float16]:
    """Rounded to 11 bits: far finer than units lie apart."""
    with np.errstate(over="ignore"):
        halves = codebook.astype(np.float16)
    if not np.isfinite(halves).all():
        raise MapFormatError("codebook", "a value is not finite or beyond 65504: such a map can't be saved")
    return halves


def _rounded(poses: NDArray[np.float32]) -> NDArray[np.int32]:
    whole = np.rint(poses.astype(np.float64) / POSE_UNIT)
    if not (np.abs(whole) <= _POSE_LIMIT).all():  # NaN is not
        raise MapFormatError("poses", "a pose is not finite or beyond 214 km: such a map can't be saved")
    return whole.astype(np.int32)


def _ordered(edges: Edges) -> dict[str, NDArray[Any]]:
    """Links have no direction and no order: the lower node first; by kind, then by the higher node, then the lower."""
    if not len(edges.first) == len(edges.second) == len(edges.kind):
        lengths = f"{len(edges.first)}, {len(edges.second)} and {len(edges.kind)}"
        raise MapFormatError("edges.first", f"first, second and kind have {lengths} entries: such a map can't be saved")
    low, high = np.minimum(edges.first, edges.second), np.maximum(edges.first, edges.second)
    order = np.lexsort((low, high, edges.kind))
    return {"edges.first": low[order], "edges.second": high[order], "edges.kind": edges.kind[order]}


def _laid_out(array: NDArray[Any], layout: Layout) -> NDArray[Any]:
    if layout.differences:
        array = np.diff(array.astype(np.int32), axis=0, prepend=np.zeros((1, *array.shape[1:]), np.int32))
    return np.ascontiguousarray(array, dtype=layout.dtype)


def _summed(differences: NDArray[np.int32]) -> NDArray[np.int32]:
    return np.cumsum(differences, axis=0, dtype=np.int32)  # wraps as the differences did


def _check_agreement(arrays: Mapping[str, NDArray[Any]]) -> None:
    """Indices must point at something, and units be somewhere: else it would fail far from here, while driving."""
    count = len(arrays["poses"])
    for group, length in ((_NODES, count), (_EDGES, len(arrays["edges.first"]))):
        for name in group:
            if len(arrays[name]) != length:
                raise MapFormatError(name, f"{len(arrays[name])} entries where {length} belong; {DAMAGED}")
    limits = {"units": len(arrays["codebook"]), "edges.first": count, "edges.second": count}
    limits["edges.kind"] = len(EdgeKind)
    for name, limit in limits.items():
        values = arrays[name]
        if values.size and (values.min() < 0 or values.max() >= limit):
            raise MapFormatError(name, f"a number is outside 0..{limit - 1}; {DAMAGED}")
    if not np.isfinite(arrays["codebook"]).all():
        raise MapFormatError("codebook", f"a number is not finite; {DAMAGED}")
