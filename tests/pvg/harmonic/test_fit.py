"""Boundary colours: what the least squares of eq. (3) recovers on the curves."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pvg.errors import SolverError
from pvg.harmonic import BoundaryFit, fit_boundary_colors, normal_equations
from pvg.harmonic import fit as fitting
from tests.pvg.harmonic.shapes import ellipse

SIZE = 192
H_MIN = 2.0
Y, X = np.mgrid[:SIZE, :SIZE].astype(float)
DOMAIN = ((X - 96) / 70) ** 2 + ((Y - 96) / 84) ** 2 < 1
CURVES = np.concatenate(
    [
        ellipse(96, 96, 69, 83),  # mask boundary
        ellipse(96, 96, 52, 62),  # inner oval
        ellipse(68, 78, 14, 5),
        ellipse(124, 78, 14, 5),
        ellipse(96, 136, 22, 9),
    ]
)


def shading(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A smooth face: key light from the left, a darker jaw, a warm cheek."""
    light = 130 + 35 * np.sin((x - 20) / 60) + 20 * np.cos(y / 50)
    cheek = 25 * np.exp(-((x - 70) ** 2 + (y - 110) ** 2) / 700)
    return np.stack([1.15 * light + cheek, 0.85 * light, 0.7 * light - 0.3 * cheek], axis=-1)


CLEAN = shading(X, Y)
TRUTH = shading(CURVES[:, 0], CURVES[:, 1])


def fit(
    image: np.ndarray,
    *,
    seed: int = 0,
    samples: int = 8000,
    smoothness: float | None = None,
    robust: bool = False,
    **options: object,
) -> BoundaryFit:
    """The fit of `samples` pixels;  smoothness: another μ;  robust: with the weights of pixels, else all weigh 1."""
    options = {"h_min": H_MIN, "domain": DOMAIN, "curve_points": CURVES, **options}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fitting, "_SAMPLES", samples)
        if smoothness is not None:
            patch.setattr(fitting, "_SMOOTHNESS", smoothness)
        if not robust:
            patch.setattr(fitting, "highlight_trust", lambda sample, _: np.ones(len(sample.points)))
            patch.setattr(normal_equations, "_REWEIGHTINGS", 0)
        return fit_boundary_colors(image, rng=np.random.default_rng(seed), **options)  # type: ignore[arg-type]


def field_at(result: BoundaryFit, points: np.ndarray) -> np.ndarray:
    """The fitted field u (eq. 2) at points (n, 2) of the domain: (n, 3) RGB, not clipped."""
    return np.asarray(result.basis.design_matrix(points) @ result.coefficients)


def rms(error: np.ndarray) -> float:
    return float(np.sqrt((error**2).mean()))


@pytest.mark.parametrize("robust", [False, True])
def test_a_constant_image_gives_that_constant(robust: bool) -> None:
    color = np.array([201, 144, 17], dtype=np.uint8)
    result = fit(np.broadcast_to(color, (SIZE, SIZE, 3)), robust=robust)
    assert result.colors.shape == (len(CURVES), 3)
    assert result.colors.dtype == np.float32
    assert np.abs(result.colors - color).max() < 1e-4


def test_linear_shading_is_recovered() -> None:
    linear = np.stack([40 + X, 200 - 0.8 * Y, 60 + 0.3 * X + 0.5 * Y], axis=-1)
    truth = np.stack([40 + CURVES[:, 0], 200 - 0.8 * CURVES[:, 1], 60 + CURVES @ (0.3, 0.5)], axis=-1)
    result = fit(linear)
    assert rms(result.colors - truth) < 0.1
    assert np.abs(result.colors - truth).max() < 0.6


def test_smooth_shading_is_recovered() -> None:
    result = fit(CLEAN)
    assert rms(result.colors - TRUTH) < 0.1
    assert np.abs(result.colors - TRUTH).max() < 0.6


def test_fitting_averages_noise_that_point_sampling_keeps() -> None:
    noisy = CLEAN + np.random.default_rng(7).normal(0, 10, CLEAN.shape)
    result = fit(noisy)
    x, y = np.rint(CURVES).astype(int).T
    point_sampled = rms(noisy[y, x] - TRUTH)
    assert point_sampled > 9
    assert rms(result.colors - TRUTH) < 0.6 * point_sampled
    smoother = fit(noisy, smoothness=1.0)
    assert rms(smoother.colors - TRUTH) < 0.25 * point_sampled


@settings(max_examples=8, deadline=None)
@given(
    gains=st.tuples(*[st.floats(0.2, 1.2)] * 3),
    offset=st.tuples(*[st.floats(0, 20)] * 3),
)
def test_the_plain_fit_commutes_with_affine_colour_maps(
    gains: tuple[float, float, float], offset: tuple[float, float, float]
) -> None:
    gain, shift = np.array(gains), np.array(offset)
    before = field_at(fit(CLEAN, samples=3000), CURVES[::4])
    after = field_at(fit(gain * CLEAN + shift, samples=3000), CURVES[::4])
    np.testing.assert_allclose(after, gain * before + shift, atol=2e-3)


def test_the_same_generator_gives_the_same_colours_and_another_does_not() -> None:
    noisy = CLEAN + np.random.default_rng(7).normal(0, 10, CLEAN.shape)
    first, again, other = (fit(noisy, seed=seed, samples=3000, robust=True) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.colors, again.colors)
    assert np.abs(first.colors - other.colors).max() > 0.1


def test_specular_blobs_do_not_tint_the_curves() -> None:
    skin = CLEAN + np.random.default_rng(1).normal(0, 3, CLEAN.shape)
    shiny = skin.copy()
    for cx, cy in ((68, 84), (96, 34), (124, 120), (96, 128)):
        shiny[(X - cx) ** 2 + (Y - cy) ** 2 < 5**2] = 255
    near = np.linalg.norm(CURVES[:, None] - [(68, 84), (96, 34), (124, 120), (96, 128)], axis=2).min(axis=1) < 5
    assert near.sum() > 10
    plain, robust = fit(shiny), fit(shiny, robust=True)
    assert rms(plain.colors[near] - TRUTH[near]) > 40
    assert rms(robust.colors[near] - TRUTH[near]) < 5
    assert np.abs(robust.colors - TRUTH).max() < 20


def test_robust_weights_leave_clean_shading_alone() -> None:
    np.testing.assert_allclose(fit(CLEAN, robust=True).colors, fit(CLEAN).colors, atol=0.5)


def test_a_face_that_is_all_highlight_keeps_its_colour() -> None:
    assert (fit(np.full((SIZE, SIZE, 3), 255, dtype=np.uint8), robust=True).colors == 255).all()


def test_background_does_not_reach_the_colours() -> None:
    for background in (0.0, 255.0):
        image = np.where(DOMAIN[..., None], CLEAN, background)
        np.testing.assert_array_equal(fit(image).colors, fit(CLEAN).colors)


def test_points_far_outside_the_domain_take_its_nearest_colour() -> None:
    curves = np.concatenate([CURVES, [[96.0, -40.0], [400.0, 96.0]]])
    result = fit(CLEAN, curve_points=curves)
    expected = shading(np.array([96.0, 165.0]), np.array([13.0, 96.0]))
    np.testing.assert_allclose(result.colors[-2:], expected, atol=1.5)


def test_separate_parts_of_a_domain_keep_their_own_colours() -> None:
    domain = ((X - 40) ** 2 + (Y - 96) ** 2 < 25**2) | ((X - 150) ** 2 + (Y - 96) ** 2 < 25**2)
    image = np.where(X[..., None] < 96, [200.0, 120.0, 90.0], [60.0, 40.0, 30.0])
    curves = np.concatenate([ellipse(40, 96, 24, 24), ellipse(150, 96, 24, 24)])
    result = fit(image, domain=domain, curve_points=curves)
    np.testing.assert_allclose(result.colors, np.where(curves[:, :1] < 96, [200, 120, 90], [60, 40, 30]), atol=0.1)


def test_colours_stay_in_range_and_the_field_can_be_shown() -> None:
    steep = np.clip(np.stack([4 * (X - 96), 255 - 4 * (X - 60), 3 * Y - 100], axis=-1), 0, 255).astype(np.uint8)
    result = fit(steep)
    assert result.colors.min() >= 0
    assert result.colors.max() <= 255
    y, x = np.nonzero(DOMAIN)
    field = field_at(result, np.stack([x, y], axis=1))
    assert field.shape == (len(x), 3)
    assert rms(field - steep[y, x]) < 0.6


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"domain": np.zeros((SIZE, SIZE), dtype=bool)}, "empty"),
        ({"domain": DOMAIN.astype(np.uint8)}, "bool"),
        ({"domain": DOMAIN[:-1]}, "shape"),
        ({"curve_points": np.zeros((0, 2))}, "curve points"),
        ({"h_min": 0.0}, "h_min"),
    ],
)
def test_bad_input_is_refused_at_the_door(changes: dict[str, object], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        fit(CLEAN, **changes)  # type: ignore[arg-type]


def test_an_image_that_is_not_finite_or_not_rgb_is_refused() -> None:
    with pytest.raises(ValueError, match="non-finite"):
        fit(np.where(X[..., None] > 90, np.nan, CLEAN))
    with pytest.raises(ValueError, match="must have shape"):
        fit(CLEAN[..., 0])


def test_missing_the_tolerance_is_an_error_with_the_residual(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(normal_equations, "_MAX_ITERATIONS", 1)
    noisy = CLEAN + np.random.default_rng(7).normal(0, 10, CLEAN.shape)
    noisy[DOMAIN & (np.random.default_rng(8).random((SIZE, SIZE)) < 0.1)] = 0
    with pytest.raises(SolverError, match=r"relative residual of [0-9.]+e-"):
        fit(noisy, robust=True)
