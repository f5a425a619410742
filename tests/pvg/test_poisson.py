from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse
from scipy.sparse.linalg import splu

from pvg.errors import SolverError
from pvg.membrane import lattice as poisson
from pvg.membrane.lattice import Lattice, Membrane, MembraneOperator, build_membrane, rasterize_curves

Layout = list[tuple[int, int, bool]]
FACE_WIDTH, FACE_HEIGHT = 800, 1096


def oval(x: float, y: float, a: float, b: float, count: int, turn: float = 1.0, start: float = 0.0) -> np.ndarray:
    """Samples of an ellipse, in fractions of the face's box; turn < 1 leaves it open."""
    angle = start + np.arange(count) / (count if turn == 1.0 else count - 1) * turn * 2 * np.pi
    return np.stack((x + a * np.cos(angle), y + b * np.sin(angle)), axis=1)


def synthetic_face() -> tuple[np.ndarray, Layout, np.ndarray]:
    """Curves of a face and corrections: a smooth skin field, other levels on lips, brows and eyes, up to ±70."""
    bridge = np.stack((np.full(13, 0.5), np.linspace(0.4, 0.58, 13)), axis=1)
    curves: list[tuple[np.ndarray, bool, float]] = [
        (oval(0.5, 0.52, 0.44, 0.44, 192), True, 0.0),
        (oval(0.5, 0.54, 0.36, 0.36, 65, 0.5), False, 0.0),
        (oval(0.5, 0.50, 0.28, 0.30, 108), True, 0.0),
        (oval(0.28, 0.60, 0.07, 0.06, 32), True, 0.0),
        (oval(0.72, 0.60, 0.07, 0.06, 32), True, 0.0),
        (bridge, False, 0.0),
        (oval(0.5, 0.58, 0.08, 0.04, 19, 0.5), False, 0.0),
        (oval(0.33, 0.42, 0.07, 0.02, 16), True, -35.0),
        (oval(0.67, 0.42, 0.07, 0.02, 16), True, -35.0),
        (oval(0.32, 0.35, 0.10, 0.018, 18), True, -25.0),
        (oval(0.68, 0.35, 0.10, 0.018, 18), True, -25.0),
        (oval(0.5, 0.72, 0.13, 0.05, 36), True, 25.0),
        (oval(0.5, 0.72, 0.10, 0.02, 24), True, 15.0),
    ]
    layout, offsets, stop = [], [], 0
    for samples, closed, offset in curves:
        layout.append((stop, stop + len(samples), closed))
        offsets.append(np.full(len(samples), offset))
        stop += len(samples)
    place = np.concatenate([samples for samples, _, _ in curves])
    field = [25 * np.sin(5 * place[:, 0] + k) + 20 * np.cos(4 * place[:, 1] - k) + 5 * k for k in range(3)]
    values = np.stack(field, axis=1) + np.concatenate(offsets)[:, None]
    points = place * (FACE_WIDTH, FACE_HEIGHT)
    return points, layout, values * (70.0 / np.abs(values).max())


def face_operator(target_height: int = poisson.TARGET_HEIGHT) -> tuple[MembraneOperator, np.ndarray]:
    points, layout, values = synthetic_face()
    lattice = Lattice.over((0, 0, FACE_WIDTH, FACE_HEIGHT), target_height=target_height)
    return build_membrane(rasterize_curves(points, layout, lattice)), values


def direct_membrane(pixels: np.ndarray, known: np.ndarray, domain: np.ndarray) -> np.ndarray:
    """SuperLU on the 5-point equations with whole pixels held: pixels (h, w, C), known and domain (h, w) bool."""
    unknown = domain & ~known
    index = np.cumsum(unknown).reshape(unknown.shape) - 1
    count = int(unknown.sum())
    rows, columns, load, degree = [], [], np.zeros((count, pixels.shape[2])), np.zeros(count)
    colors = pixels.reshape(-1, pixels.shape[2])
    flat = np.arange(unknown.size).reshape(unknown.shape)
    pairs = [(flat[:, :-1], flat[:, 1:]), (flat[:-1], flat[1:])]
    for here, there in [*pairs, *[(b, a) for a, b in pairs]]:
        i, j = here.ravel(), there.ravel()
        kept = unknown.ravel()[i] & domain.ravel()[j]
        i, j = i[kept], j[kept]
        degree += np.bincount(index.ravel()[i], minlength=count)
        held = known.ravel()[j]
        np.add.at(load, index.ravel()[i[held]], colors[j[held]])
        rows.append(index.ravel()[i[~held]])
        columns.append(index.ravel()[j[~held]])
    i, j = np.concatenate(rows), np.concatenate(columns)
    matrix = sparse.csc_array((-np.ones(len(i)), (i, j)), (count, count)) + sparse.diags_array(degree)
    solved = pixels.copy()
    factors = splu(sparse.csc_array(matrix), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    solved[unknown] = factors.solve(load)
    return solved


def four_connected_pixels(
    points: np.ndarray, layout: Layout, values: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray]:
    """γ as pixels at full size: mean values (height, width, C) and the mask of held pixels."""
    total, hits = np.zeros((height, width, values.shape[1])), np.zeros((height, width))
    for start, stop, closed in layout:
        run = [*range(start, stop), *([start] if closed else [])]
        for i, j in pairwise(run):
            share = np.linspace(0.0, 1.0, int(np.abs(points[j] - points[i]).sum() * 8) + 2)[:, None]
            pixel = np.rint(points[i] + share * (points[j] - points[i])).astype(int)
            value = values[i] + share * (values[j] - values[i])
            steps = np.flatnonzero((np.diff(pixel, axis=0) != 0).all(axis=1))  # diagonal steps get a corner
            corner = np.stack((pixel[steps, 0], pixel[steps + 1, 1]), axis=1)
            for p, v in ((pixel, value), (corner, value[steps])):
                np.add.at(total, (p[:, 1], p[:, 0]), v)
                np.add.at(hits, (p[:, 1], p[:, 0]), 1.0)
    return total / np.maximum(hits, 1.0)[..., None], hits > 0


def direct_on_lattice(operator: MembraneOperator, values: np.ndarray) -> np.ndarray:
    """SuperLU on the same cut-edge equations, assembled here from the cuts of the raster."""
    raster = operator.raster
    rows, columns = raster.lattice.height, raster.lattice.width
    _, _, w, _, _ = raster.levels[0]
    position = (np.arange(rows)[:, None] + 1) * (w + 2) + np.arange(columns) + 1
    theta = raster.theta[:, position]
    inside = (operator.inverse > 0)[position]
    count = rows * columns
    flat = np.arange(count).reshape(rows, columns)
    right = (np.isinf(theta[0, :, :-1]) & inside[:, :-1] & inside[:, 1:]).ravel()
    down = (np.isinf(theta[2, :-1]) & inside[:-1] & inside[1:]).ravel()
    i = np.concatenate((flat[:, :-1].ravel()[right], flat[:-1].ravel()[down]))
    j = np.concatenate((flat[:, 1:].ravel()[right], flat[1:].ravel()[down]))
    edges = sparse.csc_array((np.ones(len(i)), (i, j)), (count, count))
    edges = edges + edges.T
    ties, load = np.zeros(len(operator.inverse)), np.zeros((len(operator.inverse), values.shape[1]))
    np.add.at(ties, raster.node, raster.weight)
    np.add.at(load, raster.node, raster.weight[:, None] * raster.values(values))
    ties, load = ties[position].ravel(), load[position].reshape(count, -1)
    ties, load = np.where(inside.ravel(), ties, 1.0), np.where(inside.ravel()[:, None], load, 0.0)
    matrix = sparse.csc_array(sparse.diags_array(edges.sum(axis=0) + ties) - edges)
    return splu(matrix).solve(load).T.reshape(-1, rows, columns)


@pytest.fixture(scope="module")
def face() -> tuple[MembraneOperator, np.ndarray]:
    return face_operator()


def test_the_synthetic_face_has_corrections_of_70_levels_and_600_samples() -> None:
    points, _, values = synthetic_face()
    assert np.abs(values).max() == pytest.approx(70.0)
    assert len(points) == len(values) == 589
    assert np.ptp(values) > 80


def test_a_quarter_size_membrane_matches_the_direct_full_size_solve(
    face: tuple[MembraneOperator, np.ndarray],
) -> None:
    points, layout, values = synthetic_face()
    held, known = four_connected_pixels(points, layout, values, FACE_WIDTH, FACE_HEIGHT)
    assert 5_000 < known.sum() < 20_000
    y, x = np.mgrid[:FACE_HEIGHT, :FACE_WIDTH]
    # inside the boundary curve and a little beyond, where the matte lies
    domain = ((x / FACE_WIDTH - 0.5) / 0.45) ** 2 + ((y / FACE_HEIGHT - 0.52) / 0.45) ** 2 < 1.0
    inside = ((x / FACE_WIDTH - 0.5) / 0.44) ** 2 + ((y / FACE_HEIGHT - 0.52) / 0.44) ** 2 < 1.0
    reference = direct_membrane(held, known, domain)
    membrane = face[0].solve(values)
    assert 150 <= membrane.lattice.height <= 282
    error = np.abs(membrane.crop(0, 0, FACE_WIDTH, FACE_HEIGHT) - reference)[inside]
    assert error.mean() < 0.15
    assert np.percentile(error, 99) < 1.0


@pytest.mark.parametrize("tolerance", [1.0, poisson.TOLERANCE, 0.02, 0.001])
def test_the_error_stays_below_the_tolerance(face: tuple[MembraneOperator, np.ndarray], tolerance: float) -> None:
    operator, values = face
    exact = direct_on_lattice(operator, values)
    assert np.abs(operator.solve(values, tolerance=tolerance).planes - exact).max() < tolerance
    nearby = operator.solve(values + 3.0 * np.sin(np.arange(len(values)))[:, None])
    warm = operator.solve(values, guess=nearby, tolerance=tolerance)
    assert np.abs(warm.planes - exact).max() < tolerance


def test_a_missed_tolerance_raises_with_the_error(
    face: tuple[MembraneOperator, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    operator, values = face
    monkeypatch.setattr(poisson, "MAX_CYCLES", 2)
    with pytest.raises(SolverError, match=r"channel 0, is off by about [0-9.]+ levels after 2 cycles .wanted 0.01."):
        operator.solve(values, tolerance=0.01)
    with pytest.raises(SolverError, match="finer than float32"):
        operator.solve(values, tolerance=1e-6)


polylines = st.integers(0, 2**32 - 1).map(np.random.default_rng)


def random_curves(rng: np.random.Generator, width: int, height: int) -> tuple[np.ndarray, Layout, np.ndarray]:
    """A few random polylines, one of which surely crosses the lattice."""
    layout, stop = [], 0
    points = [np.array([[0.3 * width, -1.0], [0.6 * width, height + 1.0]])]
    counts = rng.integers(1, 9, rng.integers(0, 4))
    points += [rng.uniform(-0.2, 1.2, (count, 2)) * (width, height) for count in counts]
    for run in points:
        layout.append((stop, stop + len(run), bool(rng.integers(2))))
        stop += len(run)
    snapped = np.concatenate(points)
    snapped = np.where(rng.random(snapped.shape) < 0.2, np.rint(snapped), snapped)  # meet nodes and rows exactly
    return snapped, layout, rng.uniform(-70.0, 70.0, (stop, 2))


@given(polylines, st.integers(4, 60), st.integers(4, 60))
@settings(max_examples=60, deadline=None)
def test_random_curves_give_the_direct_solution_within_the_range_of_their_values(
    rng: np.random.Generator, width: int, height: int
) -> None:
    points, layout, values = random_curves(rng, width, height)
    operator = build_membrane(rasterize_curves(points, layout, Lattice.over((0, 0, width, height))))
    planes = operator.solve(values, tolerance=0.0025).planes
    assert np.abs(planes - direct_on_lattice(operator, values)).max() < 0.01
    assert (planes >= values.min(axis=0)[:, None, None] - 0.01).all()
    assert (planes <= values.max(axis=0)[:, None, None] + 0.01).all()


@given(polylines)
@settings(max_examples=40, deadline=None)
def test_random_domains_with_holes_give_the_direct_solution_or_name_the_loose_part(
    rng: np.random.Generator,
) -> None:
    width, height = 48, 40
    points, layout, values = random_curves(rng, width, height)
    blobs = np.kron(rng.random((10, 12)), np.ones((4, 4))) + 0.2 * rng.random((height, width))
    domain = blobs > rng.uniform(0.1, 0.6)
    raster = rasterize_curves(points, layout, Lattice.over((0, 0, width, height)))
    try:
        operator = build_membrane(raster, domain=domain)
    except SolverError as error:
        assert "touches no curve" in str(error) or "no curve crosses" in str(error)  # noqa: PT017
        return
    membrane = operator.solve(values, tolerance=0.0025)
    assert np.abs(membrane.planes - direct_on_lattice(operator, values)).max() < 0.01
    assert (membrane.planes[:, ~domain] == 0).all()


def test_a_part_of_the_domain_without_a_curve_is_named() -> None:
    lattice = Lattice.over((0, 0, 60, 40))
    raster = rasterize_curves([[5.0, 5.0], [15.0, 25.0], [8.0, 30.0]], [(0, 3, True)], lattice)
    domain = np.zeros((40, 60), np.bool_)
    domain[2:38, 2:30] = True
    domain[12:20, 9:11] = False  # a hole is allowed: no flux through its rim
    planes = build_membrane(raster, domain=domain).solve(np.full((3, 1), 20.0)).planes
    assert (planes[0][domain] == 20.0).all()
    assert (planes[0][~domain] == 0.0).all()
    domain[5:10, 40:50] = True
    with pytest.raises(SolverError, match=r"part 2 of the domain .50 nodes, rows 5-9, columns 40-49. touches no curve"):
        build_membrane(raster, domain=domain)
    with pytest.raises(SolverError, match="no curve crosses"):
        build_membrane(raster, domain=np.zeros((40, 60), np.bool_))


@pytest.mark.parametrize(
    ("layout", "active"), [([], None), ([(0, 2, False)], None), ([(2, 4, False)], [True, True, True, False])]
)
def test_curves_that_miss_the_lattice_are_an_error(layout: Layout, active: list[bool] | None) -> None:
    points = [[-50.0, -50.0], [-10.0, -60.0], [10.0, 10.3], [20.0, 15.0]]
    raster = rasterize_curves(points, layout, Lattice.over((0, 0, 60, 40)), active=active)
    with pytest.raises(SolverError, match="no curve crosses"):
        build_membrane(raster)


def test_an_inactive_sample_takes_its_two_segments_out() -> None:
    points = np.array([[5.0, 5.0], [30.0, 6.0], [31.0, 30.0], [6.0, 31.0], [20.0, 20.0]])
    active = np.array([True, False, True, True, True])
    lattice = Lattice.over((0, 0, 40, 40))
    partial = rasterize_curves(points, [(0, 4, True)], lattice, active=active)
    rest = rasterize_curves(points[[2, 3, 0]], [(0, 3, False)], lattice)
    np.testing.assert_array_equal(partial.theta, rest.theta)
    values = np.arange(5.0)[:, None]
    np.testing.assert_array_equal(partial.values(values), rest.values(values[[2, 3, 0]]))


@given(polylines, st.floats(-300.0, 300.0, width=32))
@settings(max_examples=20, deadline=None)
def test_constants_are_exact(rng: np.random.Generator, level: float) -> None:
    points, layout, values = random_curves(rng, 40, 30)
    operator = build_membrane(rasterize_curves(points, layout, Lattice.over((0, 0, 40, 30))))
    np.testing.assert_allclose(operator.solve(np.full_like(values, level)).planes, level, atol=1e-4)


def test_a_plane_on_the_border_is_a_plane_inside() -> None:
    corners = np.array([[3.3, 4.7], [90.1, 2.2], [96.6, 70.9], [8.4, 77.7]])
    values = (2.0 + 0.5 * corners[:, 0] - 0.25 * corners[:, 1])[:, None]
    operator = build_membrane(rasterize_curves(corners, [(0, 4, True)], Lattice.over((0, 0, 100, 80))))
    membrane = operator.solve(values, tolerance=1e-3)
    inner = np.random.default_rng(0).uniform((15, 12), (85, 65), (200, 2))
    np.testing.assert_allclose(membrane.at(inner)[:, 0], 2.0 + 0.5 * inner[:, 0] - 0.25 * inner[:, 1], atol=5e-3)


def test_the_solution_is_linear_in_the_values(face: tuple[MembraneOperator, np.ndarray]) -> None:
    operator, values = face
    other = np.roll(values, 31, axis=0)
    first, second = operator.solve(values, tolerance=2e-3), operator.solve(other, tolerance=2e-3)
    both = operator.solve(0.5 * values - 0.75 * other, tolerance=2e-3)
    np.testing.assert_allclose(both.planes, 0.5 * first.planes - 0.75 * second.planes, atol=6e-3)


def test_several_looks_share_one_operator(face: tuple[MembraneOperator, np.ndarray]) -> None:
    operator, values = face
    together = operator.solve(np.concatenate((values, -values), axis=1))
    np.testing.assert_array_equal(together.planes[:3], operator.solve(values).planes)
    np.testing.assert_allclose(together.planes[3:], -together.planes[:3], atol=1e-4)


@given(polylines, st.integers(16, 70))
@settings(max_examples=40, deadline=None)
def test_a_closed_curve_shuts_its_inside_off(rng: np.random.Generator, size: int) -> None:
    count = int(rng.integers(3, 30))
    radius = rng.uniform(0.15, 0.35, count) * size
    angle = np.arange(count) / count * 2 * np.pi
    star = size / 2 + radius[:, None] * np.stack((np.cos(angle), np.sin(angle)), axis=1)
    star = np.where(rng.random(star.shape) < 0.3, np.rint(star), star)
    frame = np.array([[0.5, 0.5], [size - 1.5, 0.5], [size - 1.5, size - 1.5], [0.5, size - 1.5]])
    points, layout = np.concatenate((star, frame)), [(0, count, True), (count, count + 4, True)]
    values = np.where(np.arange(count + 4) < count, 0.0, 60.0)[:, None]
    plane = (
        build_membrane(rasterize_curves(points, layout, Lattice.over((0, 0, size, size))))
        .solve(values, tolerance=4e-4)
        .planes[0]
    )
    centre = round(size / 2)
    assert abs(plane[centre, centre]) < 0.01
    assert plane[0, 0] == pytest.approx(60.0, abs=0.01)


def test_a_guess_of_another_box_changes_nothing_but_the_path(face: tuple[MembraneOperator, np.ndarray]) -> None:
    operator, values = face
    points, layout, _ = synthetic_face()
    moved = Lattice.over((-20, -10, 830, 1100))
    before = build_membrane(rasterize_curves(points + 3.0, layout, moved)).solve(values)
    warm, cold = operator.solve(values, guess=before), operator.solve(values)
    assert np.abs(warm.planes - cold.planes).max() < 2 * poisson.TOLERANCE


def tilted(box: tuple[int, int, int, int], target_height: int) -> Membrane:
    lattice = Lattice.over(box, target_height=target_height)
    y, x = np.mgrid[: lattice.height, : lattice.width] * lattice.step
    planes = np.stack((x + lattice.x + 2 * (y + lattice.y), 100.0 - (x + lattice.x)))
    return Membrane(lattice, planes.astype(np.float32))


@pytest.mark.parametrize("box", [(0, 0, 200, 300), (17, -9, 61, 123), (5, 5, 2, 2), (3, 4, 1, 1), (0, 0, 640, 361)])
@pytest.mark.parametrize("target_height", [20, 77, 280])
def test_a_linear_field_is_read_exactly_at_every_pixel(box: tuple[int, int, int, int], target_height: int) -> None:
    left, top, width, height = box
    y, x = np.mgrid[top : top + height, left : left + width]
    read = tilted(box, target_height).crop(*box)
    np.testing.assert_allclose(read, np.stack((x + 2 * y, 100 - x), axis=-1), atol=1e-3)


@given(st.integers(0, 299), st.integers(0, 199), st.integers(1, 80), st.integers(1, 80))
@settings(max_examples=40, deadline=None)
def test_a_crop_equals_the_same_part_of_the_whole(x: int, y: int, width: int, height: int) -> None:
    noise = np.random.default_rng(3).normal(0.0, 20.0, (3, *LATTICE_SHAPE)).astype(np.float32)
    membrane = Membrane(LATTICE, noise)
    whole = membrane.crop(0, 0, 300, 200)
    width, height = min(width, 300 - x), min(height, 200 - y)
    np.testing.assert_array_equal(membrane.crop(x, y, width, height), whole[y : y + height, x : x + width])
    np.testing.assert_allclose(membrane.at([[x, y]]), whole[y, x][None], atol=1e-3)
    chroma = membrane.read(np.arange(x, x + width, 2), np.arange(y, y + height, 2), slice(1, 3))
    np.testing.assert_array_equal(chroma[1], whole[y : y + height : 2, x : x + width : 2, 2])


LATTICE = Lattice.over((0, 0, 300, 200), target_height=57)
LATTICE_SHAPE = (LATTICE.height, LATTICE.width)


def test_reading_between_the_nodes_equals_reading_the_points() -> None:
    membrane = Membrane(LATTICE, np.random.default_rng(4).normal(0, 20, (2, *LATTICE_SHAPE)).astype(np.float32))
    xs, ys = np.array([0.25, 7.5, 298.9, 310.0]), np.array([-4.0, 3.3, 199.0])
    points = np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2)
    np.testing.assert_allclose(membrane.read(xs, ys).reshape(2, -1).T, membrane.at(points), atol=1e-3)


def test_input_of_the_wrong_shape_or_value_is_refused(face: tuple[MembraneOperator, np.ndarray]) -> None:
    operator, values = face
    with pytest.raises(ValueError, match="must have the shape"):
        operator.solve(values[:-1])
    with pytest.raises(SolverError, match="NaN"):
        operator.solve(np.full_like(values, np.nan))
    with pytest.raises(ValueError, match="channels"):
        operator.solve(values, guess=operator.solve(values[:, :1]))
    lattice = Lattice.over((0, 0, 30, 30))
    with pytest.raises(ValueError, match="finite"):
        rasterize_curves([[0.0, np.nan]], [(0, 1, False)], lattice)
    with pytest.raises(ValueError, match="leaves the 1 samples"):
        rasterize_curves([[0.0, 1.0]], [(0, 2, False)], lattice)
    with pytest.raises(ValueError, match="active"):
        rasterize_curves([[0.0, 1.0]], [(0, 1, False)], lattice, active=[True, False])
    with pytest.raises(ValueError, match="at least 1x1"):
        Lattice.over((0, 0, 0, 10))
    with pytest.raises(ValueError, match="domain"):
        build_membrane(rasterize_curves([[3.0, 1.2], [9.0, 8.0]], [(0, 2, False)], lattice), domain=[[True]])
