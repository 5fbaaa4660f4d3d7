"""Gaussian processes of the results of surveys over the free parameters of a design, with the noise of seeds.

A result is modelled as a smooth function of the parameters, a Matern 5/2 process with a length scale for each, plus
independent noise, whose variance is that from seed to seed; all are fitted by maximum likelihood (Rasmussen & Williams
2006, "Gaussian processes for machine learning", ch. 5; scikit-learn). Errors are modelled by their logarithm. Whether a
survey can be flown at all is a classifier's probability, once one has failed.
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.numerics import is_number
from sionna_radar.studies.sweep.settings import Axis, Setting, Span

# Results that are positive and modelled by their logarithm.
LOGARITHMIC = (
    "rms_m",
    "std_m",
    "nmad_m",
    "le90_m",
    "off_wall_rms_m",
    "all_cells_rms_m",
    "stated_sigma_m",
    "mapped_m2",
    "mapped_swath_m",
)
# Results between 0 and 1.
SHARES = ("coverage", "coverage_of_swath", "pd_wire", "pd_obstacle")
SMALLEST = 1e-6
# Significant digits of a proposed value: finer ones no radar is built to.
DIGITS = 3
LENGTH_SCALES = (0.05, 20.0)
NOISE = (1e-5, 1.0)
# Share of steps of a local move that take a listed value anew.
NEW_LEVEL = 0.25


@dataclass(frozen=True)
class Space:
    """The free parameters: ranges and lists of values; and those that take whole numbers only.

    A setting is a point of the unit cube, one coordinate for each parameter, ranges first.
    """

    spans: tuple[Span, ...]
    listed: tuple[Axis, ...]
    whole: frozenset[str] = frozenset()

    @property
    def keys(self) -> tuple[str, ...]:
        """The free keys, in the order of the coordinates."""
        return (*(span.key for span in self.spans), *(axis.key for axis in self.listed))

    def settings(self, fraction: Float[np.ndarray, "n key"]) -> list[Setting]:
        """Return the settings at points of the unit cube, rounded to `DIGITS`."""
        fraction = np.clip(fraction, 0.0, 1.0 - 1e-9)
        columns: list[Sequence[Any]] = [
            span.at(column, whole=span.key in self.whole, digits=DIGITS)
            for span, column in zip(self.spans, fraction.T, strict=False)
        ]
        for axis, column in zip(self.listed, fraction.T[len(self.spans) :], strict=True):
            columns.append([axis.values[int(place)] for place in column * len(axis.values)])
        return [dict(zip(self.keys, values, strict=True)) for values in zip(*columns, strict=True)]

    def shares(self, settings: Sequence[Mapping[str, Any]]) -> Float[np.ndarray, "n key"]:
        """Return the points of the unit cube of settings; of a listed value the middle of its interval."""
        columns = []
        for span in self.spans:
            value = np.array([setting[span.key] for setting in settings], dtype=float)
            low, high = span.low, span.high
            if span.logarithmic:
                value, low, high = np.log(value), np.log(low), np.log(high)
            columns.append((value - low) / (high - low))
        for axis in self.listed:
            names = [repr(value) for value in axis.values]
            place = np.array([names.index(repr(setting[axis.key])) for setting in settings])
            columns.append((place + 0.5) / len(names))
        return np.stack(columns, axis=-1)

    def inputs(self, settings: Sequence[Mapping[str, Any]]) -> Float[np.ndarray, "n feature"]:
        """Return the inputs of the models: coordinates, and for words one indicator for each."""
        share = self.shares(settings)
        columns = [share[:, : len(self.spans)]]
        for axis, column in zip(self.listed, share.T[len(self.spans) :], strict=True):
            if all(map(is_number, axis.values)):
                columns.append(column[:, None])
            else:
                columns.append((column[:, None] * len(axis.values)).astype(int) == np.arange(len(axis.values)))
        return np.concatenate(columns, axis=1).astype(float)

    def near(
        self, fraction: Float[np.ndarray, "n key"], width: float, rng: np.random.Generator
    ) -> Float[np.ndarray, "n key"]:
        """Return a random step from each point: normal in ranges, now and then another one of the listed values."""
        moved = fraction + width * rng.standard_normal(fraction.shape)
        fresh = rng.random(fraction.shape)
        keep = rng.random(fraction.shape) >= NEW_LEVEL
        first = len(self.spans)
        moved[:, first:] = np.where(keep, fraction, fresh)[:, first:]
        return np.clip(moved, 0.0, 1.0 - 1e-9)


@dataclass(frozen=True)
class Surrogate:
    """The model of one result: a fitted process of its scaled values.

    noise: standard deviation from seed to seed, in the scale of the model (relative for logarithms).
    """

    name: str
    process: Any
    middle: float
    scale: float
    noise: float

    @staticmethod
    def fit(
        name: str, inputs: Float[np.ndarray, "n feature"], values: Float[np.ndarray, " n"], kernel: Any = None
    ) -> "Surrogate":
        """Return the model of a result; with a kernel its parameters are kept and nothing is fitted but the values."""
        from sklearn.exceptions import ConvergenceWarning
        from sklearn.gaussian_process import GaussianProcessRegressor
        from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

        y = np.log(np.maximum(values, SMALLEST)) if name in LOGARITHMIC else np.asarray(values, dtype=float)
        middle, scale = float(y.mean()), float(y.std()) or 1.0
        search: dict[str, Any] = {"optimizer": None}
        if kernel is None:
            smooth = Matern(np.full(inputs.shape[1], 0.5), LENGTH_SCALES, nu=2.5)
            kernel = ConstantKernel(1.0, (0.05, 50.0)) * smooth + WhiteKernel(0.1, NOISE)
            search = {"n_restarts_optimizer": 2, "random_state": 0}
        process = GaussianProcessRegressor(kernel, alpha=1e-9, **search)
        with warnings.catch_warnings():
            # A parameter at its bound: a key without effect, or next to no noise.
            warnings.simplefilter("ignore", ConvergenceWarning)
            process.fit(inputs, (y - middle) / scale)
        return Surrogate(name, process, middle, scale, scale * float(np.sqrt(process.kernel_.k2.noise_level)))

    def moments(
        self, inputs: Float[np.ndarray, "n feature"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Return mean and standard deviation, noise left out, in the scale of the model."""
        mean, sigma = self.process.predict(inputs, return_std=True)
        latent = np.sqrt(np.maximum((self.scale * sigma) ** 2 - self.noise**2, (1e-3 * self.scale) ** 2))
        return self.middle + self.scale * mean, latent

    def draws(
        self, inputs: Float[np.ndarray, "n feature"], normal: Float[np.ndarray, " draw"], seeds: float = np.inf
    ) -> Float[np.ndarray, "n draw"]:
        """Return possible means of the result over a number of seeds at each input, for standard normal numbers."""
        mean, sigma = self.moments(inputs)
        return self.result(mean[:, None] + np.hypot(sigma, self.noise / np.sqrt(seeds))[:, None] * normal)

    def mean(self, inputs: Float[np.ndarray, "n feature"]) -> Float[np.ndarray, " n"]:
        """Return the most probable value of the result at each input."""
        return self.result(self.moments(inputs)[0])

    def result(self, modelled: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Return results for values in the scale of the model."""
        if self.name in LOGARITHMIC:
            return np.exp(modelled)
        return np.clip(modelled, 0.0, 1.0) if self.name in SHARES else modelled


def flown_probability(
    inputs: Float[np.ndarray, "n feature"], flown: Sequence[bool], at: Float[np.ndarray, "m feature"]
) -> Float[np.ndarray, " m"]:
    """Return the probability that a survey can be flown at each input; 1 where none has failed yet."""
    from sklearn.gaussian_process import GaussianProcessClassifier
    from sklearn.gaussian_process.kernels import Matern

    if all(flown) or not any(flown):
        return np.ones(len(at))
    classifier = GaussianProcessClassifier(4.0 * Matern(0.3, nu=2.5), optimizer=None)
    classifier.fit(inputs, np.array(flown, dtype=int))
    return np.asarray(classifier.predict_proba(at)[:, 1])


def check_installed() -> None:
    """Raise ScenarioError without scikit-learn."""
    from importlib.util import find_spec

    if find_spec("sklearn") is None:
        message = "needs scikit-learn, which is not installed; install the extra: pip install 'sionna-radar[design]'"
        raise ScenarioError.of_option("design", message)


def improvement(
    value: Float[np.ndarray, "n draw objective"], front: Float[np.ndarray, "point objective"]
) -> Float[np.ndarray, "n draw"]:
    """Return the improvement of values on the front reached so far; all objectives are minimised.

    One objective: on the least value reached. Two: the growth of the hypervolume of the front, whose first point is the
    corner from which it counts (Zitzler & Thiele 1999).
    """
    if value.shape[-1] == 1:
        return np.maximum(front.min() - value[..., 0], 0.0)
    corner, reached = front[0], pareto(front[1:])
    first = np.concatenate([[-np.inf], reached[:, 0], [corner[0]]])
    ceiling = np.concatenate([[corner[1]], reached[:, 1]])
    gained = np.zeros(value.shape[:-1])
    for low, high, top in zip(first[:-1], first[1:], ceiling, strict=True):
        width = np.maximum(np.minimum(high, corner[0]) - np.maximum(low, value[..., 0]), 0.0)
        gained += width * np.maximum(min(top, corner[1]) - value[..., 1], 0.0)
    return gained


def pareto(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "m 2"]:
    """Return the points that no other one beats in both objectives, by the first one."""
    if len(points) == 0:
        return points
    ordered = points[np.lexsort((points[:, 1], points[:, 0]))]
    return ordered[np.r_[True, ordered[1:, 1] < np.minimum.accumulate(ordered[:, 1])[:-1]]]
