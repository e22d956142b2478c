"""What `train`, `map info` and `map prune` tell of a map."""

from __future__ import annotations

from typing import Any

from omnibotd.core.mapping.topo_map import EdgeKind, TopoMap
from omnibotd.io.map_store import MapStore


def summary(store: MapStore, topo_map: TopoMap) -> dict[str, Any]:
    """Sizes and training errors; reads the store's directory."""
    size = next((entry.bytes for entry in store.list() if entry.name == topo_map.name), 0)
    counts = {kind.name.lower(): int((topo_map.edges.kind == kind).sum()) for kind in EdgeKind}
    return {
        "map": topo_map.name,
        "nodes": len(topo_map),
        "links": counts,
        "units": len(topo_map.codebook),
        "bytes": size,
        "kb_per_1000_nodes": round(size / 1024 / max(1, len(topo_map)) * 1000, 1),
        "quantization_error": topo_map.statistics.get("quantization_error"),
        "topographic_error": topo_map.statistics.get("topographic_error"),
    }
