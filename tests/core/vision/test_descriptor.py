"""Spectra and circular correlation against definitions worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from omnibotd.core.vision.descriptor import (
    FEATURES,
    RING_WEIGHTS,
    Descriptor,
    correlate,
    correlate_views,
    harmonics,
    turned,
    turned_with_slope,
    weighted_norms,
)
from omnibotd.core.vision.view import RINGS, SECTORS


def smooth_view(seed: int) -> np.ndarray:
    """A random view of few harmonics, so that turning it by any angle is exact."""
    rng = np.random.default_rng(seed)
    angles = np.arange(SECTORS) * 2 * math.pi / SECTORS
    orders = np.arange(1, 8)[:, None]
    waves = np.cos(orders * angles + rng.uniform(0, 2 * math.pi, (RINGS, 7, 1)))
    return np.einsum("rk,rka->ra", rng.standard_normal((RINGS, 7)), waves).astype(np.float32)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 1000), st.integers(0, SECTORS - 1))
def test_spectrum_is_blind_to_turns(seed: int, shift: int) -> None:
    view = np.random.default_rng(seed).standard_normal((RINGS, SECTORS)).astype(np.float32)
    spectrum = Descriptor.spectrum(view)
    assert spectrum.shape == (FEATURES,)
    np.testing.assert_allclose(Descriptor.spectrum(np.roll(view, shift, 1)), spectrum, atol=1e-4)


def test_spectrum_tells_views_apart() -> None:
    a, b = Descriptor.spectrum(smooth_view(1)), Descriptor.spectrum(smooth_view(2))
    assert np.linalg.norm(a - b) > 0.3 * np.linalg.norm(a)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 1000), st.floats(-3.1, 3.1))
def test_correlation_finds_the_heading(seed: int, yaw: float) -> None:
    stored = smooth_view(seed)
    # A base turned by +yaw sees everything at bearings smaller by yaw.
    query = turned(stored, np.asarray(-yaw))
    turn, score = correlate(harmonics(query), harmonics(stored)[None])
    assert abs(math.remainder(float(turn[0]) - yaw, math.tau)) < math.radians(0.5)
    assert 0.97 < score[0] < 1.01


def test_correlation_of_whole_sectors_is_the_normalised_product() -> None:
    rng = np.random.default_rng(0)
    query, stored = rng.standard_normal((2, RINGS, SECTORS)).astype(np.float32)
    a, b = query * RING_WEIGHTS, stored * RING_WEIGHTS
    a, b = a - a.mean(), b - b.mean()
    products = [float((np.roll(a, k, 1) * b).sum()) for k in range(SECTORS)]
    best = int(np.argmax(products))
    turn, score = correlate(harmonics(query), harmonics(stored)[None])
    expected = products[best] / (np.linalg.norm(a) * np.linalg.norm(b))
    assert abs(math.remainder(float(turn[0]) - best * math.tau / SECTORS, math.tau)) <= math.pi / SECTORS
    assert score[0] == pytest.approx(expected, rel=0.3)
    assert score[0] >= expected - 1e-4


@pytest.mark.parametrize("seed", range(3))
def test_one_product_with_all_turns_correlates_as_transforms_do(seed: int) -> None:
    rng = np.random.default_rng(seed)
    query, views = rng.standard_normal((RINGS, SECTORS)), rng.standard_normal((7, RINGS, SECTORS)) + 0.3
    views[0] = np.roll(query, 5, 1) + 0.1 * views[0]
    views = views.astype(np.float32)
    query_harmonics = harmonics(query.astype(np.float32))
    expected = correlate(query_harmonics, harmonics(views))
    found = correlate_views(query_harmonics, views, weighted_norms(views))
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_featureless_views_correlate_with_nothing() -> None:
    blank = np.zeros((RINGS, SECTORS), np.float32)
    _, score = correlate(harmonics(blank), harmonics(smooth_view(3))[None])
    assert score[0] == pytest.approx(0.0, abs=1e-6)


def test_turned_moves_bearings_into_map_axes() -> None:
    view = np.zeros((RINGS, SECTORS), np.float32)
    view[:, 8] = 1.0  # something at bearing 45 degrees
    in_map = turned(view, np.asarray(math.pi / 2))  # of a base that heads along +y
    assert int(in_map[0].argmax()) == 8 + SECTORS // 4


@pytest.mark.parametrize("yaw", [0.0, 0.3, -2.0])
def test_turned_with_slope(yaw: float) -> None:
    view, step = smooth_view(5), 1e-2
    same, slope = turned_with_slope(view, yaw)
    np.testing.assert_allclose(same, turned(view, np.asarray(yaw)), atol=1e-5)
    difference = (turned(view, np.asarray(yaw + step)) - turned(view, np.asarray(yaw - step))) / (2 * step)
    np.testing.assert_allclose(slope, difference, atol=0.05)
