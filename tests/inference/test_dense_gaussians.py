"""Fast formulas of normal distributions, compared with dense matrices."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.stats import multivariate_normal

from stringcast.stages.inference import basis, initial_state, noise
from stringcast.stages.inference.discrepancy import Discrepancy
from stringcast.stages.inference.discrepancy_basis import DiscrepancyBasis, matern_root
from stringcast.stages.inference.discrepancy_grid import (
    COURSE_COUNT,
    DISCREPANCY_SCALES_M,
    log_grid_prior,
    most_likely_grid_point,
    sizes_by_course,
)
from stringcast.stages.inference.noise_basis import (
    JointNoiseBasis,
    SeparableNoiseBasis,
    find_noise_basis,
)

FRAMES, POINTS, LENGTH = 9, 6, 0.3
SCALES = len(DISCREPANCY_SCALES_M)
SCALE_INDEX = int(np.searchsorted(DISCREPANCY_SCALES_M, 2e-3))
LATE = 3 * SCALES + SCALE_INDEX  # a grid point that begins in the middle
GROWTH = np.linspace(0.2, 1.5, FRAMES)


def make_film(times, sigma):
    """Make a trial of frames at `times` that all show the same places."""
    s = np.linspace(0.05, LENGTH, POINTS)
    return SimpleNamespace(
        times=times,
        frame=np.repeat(np.arange(FRAMES), POINTS),
        s=np.tile(s, FRAMES),
        sigma=sigma,
        model=SimpleNamespace(string=SimpleNamespace(length=LENGTH)),
        noise=noise.WHITE_NOISE,
    )


# With smaller sigma in later frames, time and place do not separate
MIXED_SIGMA_M = np.linspace(5e-4, 2e-3, FRAMES * POINTS)
# Here they separate, and there are more frames than splines
SEPARABLE_SIGMA_M = np.tile(np.linspace(5e-4, 2e-3, POINTS), FRAMES)


@pytest.fixture(params=["mixed", "separable"])
def film(request):
    """Return a trial of nine frames, at the knots of the splines or twice as dense."""
    times = basis.KNOT_SPACING_S * np.arange(FRAMES)
    if request.param == "mixed":
        return make_film(2.0 + times, MIXED_SIGMA_M)
    return make_film(2.0 + 0.5 * times, SEPARABLE_SIGMA_M)


@pytest.fixture
def shapes():
    return np.random.default_rng(1).standard_normal((2 * FRAMES * POINTS, 3))


@pytest.fixture
def errors(film, shapes):
    return Discrepancy.for_trial(film, GROWTH, shapes)


def root_at_points(film, size):
    """Compute a root of the covariance at the points of a discrepancy of unit size.

    size: its relative size at each frame, (F,).
    """
    growth = size / np.sqrt(np.mean(size**2))
    in_time = (growth[:, None] * matern_root(film.times))[film.frame]
    in_place = basis.place_functions(film.s, LENGTH) / film.sigma[:, None]
    return np.einsum("nr,nk->nrk", in_time, in_place).reshape(len(film.s), -1)


def test_the_covariance_of_a_discrepancy_is_its_kernel(film):
    growth = np.linspace(0.2, 1.5, FRAMES)
    root = root_at_points(film, growth)
    t = film.times[film.frame]
    rate = np.sqrt(3) / 0.08
    gap_s = np.abs(t[:, None] - t)
    in_time = (1 + rate * gap_s) * np.exp(-rate * gap_s)
    gap = (film.s[:, None] - film.s) / (0.35 * LENGTH)
    size = growth / np.sqrt(np.mean(growth**2))
    each = size[film.frame] * film.s / LENGTH / film.sigma
    expected = np.outer(each, each) * in_time * np.exp(-0.5 * gap**2)
    assert root @ root.T == pytest.approx(expected, abs=1e-3 * expected.max())


def test_the_correlation_time_is_at_least_two_knot_spacings(film):
    """In a minute, 64 splines are 0.95 s apart; the correlation time is twice that."""
    film.times = np.linspace(0.0, 60.0, FRAMES)
    film.sigma = np.ones(FRAMES * POINTS)
    root = root_at_points(film, np.ones(FRAMES))[film.s == LENGTH]
    gap = np.sqrt(3) * 7.5 / (2 * 60 / 63)
    expected = (1 + gap) * np.exp(-gap)
    assert root[0] @ root[1] == pytest.approx(expected, abs=0.02)
    assert root[0] @ root[0] == pytest.approx(1.0, abs=0.02)


def test_white_noise_is_white_in_the_coefficients(errors):
    coefficients = errors.coefficients(np.eye(2 * FRAMES * POINTS))
    count = coefficients.shape[1]
    assert coefficients.T @ coefficients == pytest.approx(np.eye(count), abs=1e-4)


def dense_discrepancy(film, errors, grid_point):
    """Compute the covariance of coefficients at a grid point from that of points."""
    course, scale_index = divmod(grid_point, SCALES)
    root = root_at_points(film, sizes_by_course(film.times, GROWTH)[course])
    at_points = np.zeros((2 * len(root), 2 * root.shape[1]))
    at_points[::2, : root.shape[1]] = root  # x
    at_points[1::2, root.shape[1] :] = root  # y
    columns = errors.coefficients(at_points.T).T
    return DISCREPANCY_SCALES_M[scale_index] ** 2 * columns @ columns.T


def test_the_likelihood_of_every_grid_point_is_that_of_the_dense_covariance(
    film, errors, shapes
):
    residuals = 3.0 * np.random.default_rng(2).standard_normal((4, len(shapes)))
    coefficients = errors.coefficients(residuals)
    found = errors.log_likelihood_by_grid_point(coefficients)
    assert found.shape == (4, COURSE_COUNT * SCALES)
    columns = errors.coefficients(shapes.T).T
    count = coefficients.shape[1]
    for course in range(COURSE_COUNT):
        for scale_index in (0, 4, 9, 14):
            grid_point = course * SCALES + scale_index
            smooth = dense_discrepancy(film, errors, grid_point)
            covariance = np.eye(count) + smooth + columns @ columns.T
            dense = multivariate_normal(cov=covariance).logpdf(coefficients)
            expected = dense + 0.5 * count * np.log(2 * np.pi)
            assert found[:, grid_point] == pytest.approx(expected, rel=1e-6)
            white = errors.whiten(residuals, grid_point)
            pull = np.linalg.solve(covariance, coefficients.T)
            square = np.sum(coefficients.T * pull, axis=0)
            assert np.sum(white**2, axis=1) == pytest.approx(square)


def test_a_nuisance_of_another_size_has_the_likelihood_of_scaled_shapes(
    film, shapes, errors
):
    residual = np.random.default_rng(2).standard_normal((2, 2 * FRAMES * POINTS))
    coefficients = errors.coefficients(residual)
    sizes = np.array([[1.0, 1.0, 1.0], [1.0, 0.5, 30.0], [1.0, 1.0, 0.0]])
    found = errors.log_likelihood_by_nuisance_size(coefficients, sizes)
    for by_grid_point, size in zip(found, sizes, strict=True):
        scaled = Discrepancy.for_trial(film, GROWTH, size * shapes)
        expected = scaled.log_likelihood_by_grid_point(coefficients)
        assert by_grid_point == pytest.approx(expected)


@pytest.mark.parametrize("grid_point", [SCALE_INDEX, LATE])
def test_residuals_are_split_into_discrepancy_nuisance_and_noise(
    film, errors, shapes, grid_point
):
    residual = 3.0 * np.random.default_rng(2).standard_normal(len(shapes))
    coefficients = errors.coefficients(residual[None])[0]
    columns = errors.coefficients(shapes.T).T
    smooth = dense_discrepancy(film, errors, grid_point)
    covariance = np.eye(len(columns)) + smooth + columns @ columns.T
    pull = np.linalg.solve(covariance, coefficients)
    mean = errors.posterior_mean(coefficients, grid_point)
    found = errors.coefficients(mean[None])[0]
    assert found == pytest.approx(smooth @ pull, abs=1e-4)
    explained = errors.nuisance_mean(coefficients, grid_point)
    assert explained == pytest.approx(shapes @ (columns.T @ pull))


@pytest.mark.parametrize("grid_point", [SCALE_INDEX, LATE])
def test_posterior_samples_of_a_discrepancy_have_its_posterior_variance(
    film, errors, grid_point
):
    """Their covariance in coefficients is C - C (1 + C)^-1 C."""
    smooth = dense_discrepancy(film, errors, grid_point)
    count = len(smooth)
    rng = np.random.default_rng(3)
    everywhere = np.ones(FRAMES * POINTS, dtype=bool)
    drawn = errors.sample_posterior(np.zeros(count), grid_point, 4000, rng, everywhere)
    left = smooth - smooth @ np.linalg.solve(np.eye(count) + smooth, smooth)
    half = count // 2
    units = np.eye(count)[:half]  # of x
    to_points = errors.basis.at_points(units, everywhere)[:, ::2].T
    expected = np.einsum("ni,ij,nj->n", to_points, left[:half, :half], to_points)
    assert drawn.var(axis=0) == pytest.approx(np.repeat(expected, 2), rel=0.15)
    x, y = drawn[:, ::2], drawn[:, 1::2]
    assert np.mean(x * y) == pytest.approx(0.0, abs=0.1 * np.mean(x**2))


@pytest.mark.parametrize("course", [0, 2, 4, COURSE_COUNT - 1])
def test_the_course_of_a_discrepancy_is_found(film, course):
    """Draw twenty discrepancies of 20 mm with the same course, and add noise."""
    film.times = np.linspace(2.0, 3.2, FRAMES)
    errors = Discrepancy.for_trial(film, GROWTH, np.zeros((2 * len(film.s), 0)))
    rng = np.random.default_rng(4)
    root = root_at_points(film, sizes_by_course(film.times, GROWTH)[course])
    amplitudes = rng.standard_normal((20, root.shape[1], 2))
    residuals = (0.02 * root @ amplitudes).reshape(20, -1)
    residuals += rng.standard_normal(residuals.shape)
    likelihood = errors.log_likelihood_by_grid_point(errors.coefficients(residuals))
    found = most_likely_grid_point(likelihood) // SCALES
    assert np.median(found) == course


def test_all_courses_have_the_same_prior():
    by_course = np.exp(log_grid_prior()).reshape(COURSE_COUNT, SCALES)
    assert by_course.sum(axis=1) == pytest.approx(1 / COURSE_COUNT)


def test_a_discrepancy_is_a_hundredth_before_its_onset(film):
    sizes = sizes_by_course(film.times, GROWTH)
    assert sizes[0] == pytest.approx(GROWTH)
    middle = film.times[0] + 0.5 * np.ptp(film.times)
    expected = np.where(film.times < middle, 0.01 * GROWTH, GROWTH)
    assert sizes[3] == pytest.approx(expected)
    assert sizes[-1] == pytest.approx(1.0)  # it neither begins nor grows


def test_time_and_place_separate_if_all_frames_show_the_same_places():
    times = 2.0 + 0.5 * basis.KNOT_SPACING_S * np.arange(FRAMES)
    film = make_film(times, SEPARABLE_SIGMA_M)
    alike = DiscrepancyBasis.for_trial(film, GROWTH)
    assert isinstance(alike.noise_basis, SeparableNoiseBasis)
    # missing points, frames with smaller sigma, and too few frames
    film.sigma = np.repeat(np.linspace(5e-4, 2e-3, FRAMES), POINTS)
    few_frames = make_film(2 * times, SEPARABLE_SIGMA_M)
    some = make_film(times, SEPARABLE_SIGMA_M[1:])
    some.frame, some.s = some.frame[1:], some.s[1:]
    for other in (film, few_frames, some):
        joint = DiscrepancyBasis.for_trial(other, GROWTH)
        assert isinstance(joint.noise_basis, JointNoiseBasis)


def functions_at_points(smooth):
    """Multiply functions of time by functions of place at each point, (n, K B)."""
    in_time = smooth.in_time[smooth.frame]
    products = np.einsum("nk,nb->nkb", smooth.in_place, in_time)
    return products.reshape(len(in_time), -1)


def test_sums_over_points_are_those_of_all_products(film):
    """Frames may have fewer points, in any order."""
    kept = np.random.default_rng(7).permutation(FRAMES * POINTS)[:-11]
    film.frame, film.s, film.sigma = film.frame[kept], film.s[kept], film.sigma[kept]
    smooth = find_noise_basis(film).functions
    dense = functions_at_points(smooth)
    values = np.random.default_rng(8).standard_normal((3, len(kept), 2))
    sums = np.einsum("cna,nj->caj", values, dense).reshape(6, -1)
    assert smooth.sums(values.reshape(3, -1)) == pytest.approx(sums, abs=1e-12)

    factors = np.random.default_rng(9).standard_normal((6, dense.shape[1]))
    chosen = film.s > 0.2
    points = np.einsum("caj,nj->cna", factors.reshape(3, 2, -1), dense[chosen])
    found_points = smooth.at_points(factors, chosen)
    assert found_points == pytest.approx(points.reshape(3, -1), abs=1e-12)

    gram = smooth.gram_by_frame(1 / film.sigma)
    products = basis.sum_products(smooth.in_time, matern_root(film.times), gram)
    root = root_at_points(film, np.ones(FRAMES))
    times_places = root.reshape(len(kept), -1, basis.PLACE_FUNCTIONS)
    by_place = times_places.transpose(0, 2, 1).reshape(len(kept), -1)
    expected = dense.T @ by_place
    assert products == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


def test_coefficients_are_recovered_from_the_points_evaluated_from_them(film):
    errors = DiscrepancyBasis.for_trial(film, GROWTH)
    count = errors.coefficients(np.zeros((1, 2 * len(film.s)))).shape[1]
    everywhere = np.ones(len(film.s), dtype=bool)
    there_and_back = errors.coefficients(errors.at_points(np.eye(count), everywhere))
    assert there_and_back == pytest.approx(np.eye(count), abs=1e-6)


@pytest.mark.parametrize("correlation", [0.0, 0.3])
def test_the_restricted_likelihood_is_that_of_dense_matrices(correlation):
    """Compare with the likelihood of contrasts that contain no smooth motion.

    The prior has the weight of PLACE_FUNCTIONS frames of white noise.
    """
    rng = np.random.default_rng(4)
    places = basis.PLACE_FUNCTIONS
    tracks = []
    for frames, splines in ((12, 3), (9, 2)):
        smooth = rng.standard_normal((frames, splines))
        smooth = np.column_stack([smooth, smooth[:, 0]])  # one of them occurs twice
        values = rng.standard_normal((frames, 2 * places))
        tracks.append(noise.NoiseTrack(smooth, values))

    scatter = places * np.eye(places)
    degrees = places
    log_determinants = 0.0
    for track in tracks:
        frames = len(track.place_residuals)
        in_time = toeplitz(correlation ** np.arange(frames))
        smooth = track.time_splines[:, :-1]
        precision = np.linalg.inv(in_time)
        curvature = smooth.T @ precision @ smooth
        projection = precision @ smooth @ np.linalg.solve(curvature, smooth.T)
        contrast = precision - projection @ precision
        for coordinate in range(2):
            values = track.place_residuals[:, coordinate::2]
            scatter += values.T @ contrast @ values
        degrees += 2 * (frames - smooth.shape[1])
        log_determinants += np.linalg.slogdet(in_time)[1]
        log_determinants += np.linalg.slogdet(curvature)[1]
    covariance = scatter / degrees
    twice = 2 * places * log_determinants + degrees * np.linalg.slogdet(covariance)[1]

    found, place_covariance = noise._restricted_likelihood(tracks, correlation)
    assert place_covariance == pytest.approx(covariance)
    assert found == pytest.approx(-0.5 * twice, abs=1e-6)


def test_noise_is_estimated_from_the_quieter_half_of_the_trials():
    rng = np.random.default_rng(5)
    frames = 60
    time = np.column_stack([np.ones(frames), np.arange(frames)])
    tracks = []
    for size in (9.0, 1.0, 1.2, 9.0):
        values = size * rng.standard_normal((frames, 2 * basis.PLACE_FUNCTIONS))
        tracks.append(noise.NoiseTrack(time, values))
    quiet = noise._most_likely_noise([tracks[1], tracks[2], tracks[0]])
    for kept in (tracks[0], tracks[3]):
        third = noise._most_likely_noise([tracks[1], tracks[2], kept])
        if third.variance_of_means < quiet.variance_of_means:
            quiet = third
    found = noise.fit_noise_model(tracks)
    assert found.place_covariance == pytest.approx(quiet.place_covariance, rel=1e-3)
    alone = noise.fit_noise_model(tracks[:2])
    both = noise._most_likely_noise([tracks[1], tracks[0]])
    assert alone.place_covariance == pytest.approx(both.place_covariance, rel=1e-3)


def test_the_frame_correlation_is_at_most_one_half():
    smooth = np.cumsum(np.random.default_rng(6).standard_normal((80, 12)), axis=0)
    track = noise.NoiseTrack(np.ones((80, 1)), smooth)
    found = noise.fit_noise_model([track])
    assert found.frame_correlation == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize("hinge", [0.0, 1.0])
def test_the_posterior_of_a_random_walk_is_that_of_a_dense_normal(hinge):
    """Its steps are independent, and the first one is to the middle of a piece."""
    rng = np.random.default_rng(7)
    pieces, places, wander = initial_state.CURVE_PIECES, 5, 0.7
    slope = rng.standard_normal((2 * places, pieces))
    offset = rng.standard_normal(2 * places)
    sigma = rng.uniform(0.5, 2.0, places)
    step = np.full(pieces, wander**2 / pieces)
    step[0] = wander**2 * (0.5 / pieces + hinge)
    adds = np.tril(np.ones((pieces, pieces)))
    prior = adds @ np.diag(step) @ adds.T
    covariance = slope @ prior @ slope.T + np.diag(np.repeat(sigma**2, 2))
    mean, evidence = initial_state._random_walk_posterior(
        slope, offset, sigma, wander, hinge
    )
    assert mean == pytest.approx(prior @ slope.T @ np.linalg.inv(covariance) @ offset)
    dense = multivariate_normal(cov=covariance).logpdf(offset)
    assert evidence == pytest.approx(dense + places * np.log(2 * np.pi))


def test_means_of_correlated_frames_vary_more():
    places = basis.PLACE_FUNCTIONS
    found = noise.Noise(np.diag(np.arange(1.0, places + 1)), 0.5)
    assert found.variance_of_means == pytest.approx(3.5 * 3)
