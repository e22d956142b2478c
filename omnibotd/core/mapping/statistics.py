"""What a map says about itself: how well it is organised, linked and told apart."""

from __future__ import annotations

import numpy as np

from omnibotd.core.mapping.drive import Drive
from omnibotd.core.mapping.relaxation import Floats
from omnibotd.core.mapping.som import Som
from omnibotd.core.mapping.topo_map import EdgeKind, Edges
from omnibotd.core.vision.descriptor import Harmonics, correlate

# Nodes compared with the whole map: enough for a share to a few per cent.
_PROBED = 200
# A look-alike is elsewhere when it is this far (m), and rivals the true place when its score comes this near.
ELSEWHERE, _RIVAL = 0.5, 0.07
_SAME_PLACE = 0.3


def describe(drive: Drive, som: Som, views: Harmonics, poses: Floats, edges: Edges) -> dict[str, float]:
    """Statistics by name; scores are correlations, residuals metres, errors those of the SOM side by side."""
    at_home, elsewhere = _likeness(views, poses)
    kinds = {kind: edges.kind == kind for kind in EdgeKind}
    return {
        "samples": float(drive.samples),
        "path_length": float(np.hypot(*drive.steps()[:, :2].T).sum()),
        "quantization_error": som.quantization_error(drive.spectra),
        "topographic_error": som.topographic_error(drive.spectra),
        "contrast": drive.contrast,
        "odometry_links": float(kinds[EdgeKind.ODOMETRY].sum()),
        "similarity_links": float(kinds[EdgeKind.SIMILARITY].sum()),
        "proximity_links": float(kinds[EdgeKind.PROXIMITY].sum()),
        "odometry_residual": _odometry_residual(drive, poses),
        "score_at_home": float(np.median(at_home)),
        "score_elsewhere": float(np.median(elsewhere)),
        "ambiguity": float((elsewhere > at_home - _RIVAL).mean()),
    }


def _likeness(views: Harmonics, poses: Floats) -> tuple[Floats, Floats]:
    """Best score of probed nodes against others within _SAME_PLACE, and against those beyond ELSEWHERE."""
    probed = np.unique(np.linspace(0, len(poses) - 1, _PROBED).astype(int))
    at_home, elsewhere = [], []
    for node in probed:
        _, score = correlate(views[node], views)
        apart = np.hypot(poses[:, 0] - poses[node, 0], poses[:, 1] - poses[node, 1])
        apart[node] = np.inf
        score[node] = -1.0
        at_home.append(score[apart < _SAME_PLACE].max(initial=-1.0))
        apart[node] = 0.0
        elsewhere.append(score[apart > ELSEWHERE].max(initial=-1.0))
    return np.array(at_home), np.array(elsewhere)


def _odometry_residual(drive: Drive, poses: Floats) -> float:
    """Median difference (m) between a step's length by odometry and in the relaxed map."""
    step = np.diff(poses[:, :2], axis=0)
    return float(np.median(np.abs(np.hypot(step[:, 0], step[:, 1]) - np.hypot(*drive.steps()[1:, :2].T))))
