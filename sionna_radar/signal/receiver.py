"""The receiver: noisy sampled beat signals from paths."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Inexact, Int

from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.randomness import Stream, pulse_generators
from sionna_radar.foundation.threads import over_rows
from sionna_radar.radar.chirp import Chirp
from sionna_radar.signal.analog_filters import HighPass
from sionna_radar.signal.beat import synthesise
from sionna_radar.signal.stages import Chain, Received
from sionna_radar.tracing.paths import Paths


def add_noise(
    beat: Inexact[np.ndarray, "pulse sample"],
    power: float,
    seed: int,
    pulse: Int[np.ndarray, " pulse"],
    channel: int = 0,
) -> Inexact[np.ndarray, "pulse sample"]:
    """Return beat signals with white Gaussian noise of a given power; complex signals get half of it in each part.

    Each pulse has its own generator, for each of several receivers by its `channel`; a zero signal gives the noise
    alone.

    Parameters
    ----------
    beat:
        Beat signals, sqrt(W); real or complex.
    power:
        Noise power of a sample, W.
    seed:
        Seed of the scenario.
    pulse:
        Indices of the pulses in the survey.
    channel:
        Number of the receiver.

    Returns
    -------
    Beat signals with noise, of the same type.
    """
    noisy = np.empty_like(beat)

    def add(start: int, stop: int) -> None:
        """Write some beat signals with noise."""
        generators = pulse_generators(seed, Stream.NOISE, pulse[start:stop], channel)
        for row, clean, generator in zip(noisy[start:stop], beat[start:stop], generators, strict=True):
            components = row.view(np.float64)  # a complex sample is two of these
            generator.standard_normal(out=components)
            components *= np.sqrt(power * len(row) / len(components))
            row += clean

    over_rows(add, len(noisy))
    return noisy


def noisy(received: Received) -> Received:
    """Return the received signal with thermal noise; one draw covers all sweeps of a pulse."""
    kind = np.complex128 if received.chirp.sampling == "iq" else np.float64
    points = received.sweeps * received.chirp.samples * received.noise_points
    silence = np.zeros((len(received.pulses), points), dtype=kind)
    power_w = received.noise_power_w * received.noise_points
    noise = add_noise(silence, power_w, received.seed, received.pulses.index, received.channel)
    return replace(received, noise=np.split(noise, received.sweeps, axis=1)[received.sweep])


@dataclass(frozen=True, kw_only=True)
class Reception:
    """The beat signals of each sweep of a block, and the samples of each pulse that a converter clipped.

    saturated: of the first receiver; None without a converter that has a full scale.
    """

    beats: list[Inexact[np.ndarray, "pulse sample"]]
    saturated: Int[np.ndarray, " pulse"] | None = None


@dataclass(frozen=True, kw_only=True)
class Receiver:
    """Sweeps, powers and noise of a radar.

    sweeps: the sweeps of one pulse: a single one, or the up- and the down-sweep of a triangle.
    noise_power_w: noise power of a sample, on the scale of `transmit_power_w`.
    seed: of the noise.
    high_pass: None if there is none.
    chain: its stages; None for an ideal receiver with only noise and a high-pass.
    """

    sweeps: tuple[Chirp, ...]
    transmit_power_w: float
    noise_power_w: float
    seed: int
    high_pass: HighPass | None = None
    chain: Chain | None = None

    @property
    def chirp(self) -> Chirp:
        """The first sweep of a pulse."""
        return self.sweeps[0]

    def beat(self, paths: Paths, pulses: Pulses, channel: int = 0) -> Inexact[np.ndarray, "pulse sample"]:
        """Return the beat signals of the first sweep of a block's pulses, as if it were the only one."""
        return self._receive(paths, pulses, self.sweeps[:1], channel)[0]

    def beats(self, paths: Paths, pulses: Pulses, channel: int = 0) -> list[Inexact[np.ndarray, "pulse sample"]]:
        """Return the beat signals of each sweep of a block's pulses, scaled to the transmitted power, with noise.

        channel: index of the receiver; each has independent noise.
        """
        return self._receive(paths, pulses, self.sweeps, channel)

    def reception(self, paths: Paths, pulses: Pulses) -> Reception:
        """Return the beat signals of each sweep of a block's pulses, and the numbers of clipped samples."""
        if self.chain is None:
            return Reception(beats=self.beats(paths, pulses))
        swept = self._through(self.chain, paths, pulses, self.sweeps, 0)
        saturated = [received.saturated for received in swept if received.saturated is not None]
        return Reception(
            beats=[received.signal for received in swept], saturated=np.sum(saturated, axis=0) if saturated else None
        )

    def noise(self, pulses: Pulses) -> Inexact[np.ndarray, "pulse sample"]:
        """Return the noise in the first sweep of a block's pulses, of a receiver without a high-pass."""
        kind = np.complex128 if self.chirp.sampling == "iq" else np.float64
        silence = np.zeros((len(pulses), self.chirp.samples), dtype=kind)
        return add_noise(silence, self.noise_power_w, self.seed, pulses.index)

    def _receive(
        self, paths: Paths, pulses: Pulses, sweeps: tuple[Chirp, ...], channel: int
    ) -> list[Inexact[np.ndarray, "pulse sample"]]:
        if self.chain is not None:
            return [received.signal for received in self._through(self.chain, paths, pulses, sweeps, channel)]
        amplitude, high_pass = np.sqrt(self.transmit_power_w), self.high_pass
        if high_pass is None:
            clean = [amplitude * synthesise(paths, pulses, sweep) for sweep in sweeps]
            joined = clean[0] if len(clean) == 1 else np.concatenate(clean, axis=1)
            beat = add_noise(joined, self.noise_power_w, self.seed, pulses.index, channel)
            return np.split(beat, len(sweeps), axis=1)
        echoes = [synthesise(high_pass.filtered(paths, sweep), pulses, sweep) for sweep in sweeps]
        silence = np.zeros_like(np.concatenate(echoes, axis=1))
        noise = np.split(add_noise(silence, self.noise_power_w, self.seed, pulses.index, channel), len(sweeps), axis=1)
        return [
            amplitude * echo + high_pass.shaped(sweep_noise, sweep.sampling_rate_hz)
            for echo, sweep_noise, sweep in zip(echoes, noise, sweeps, strict=True)
        ]

    def _through(
        self, chain: Chain, paths: Paths, pulses: Pulses, sweeps: tuple[Chirp, ...], channel: int
    ) -> list[Received]:
        """Return each sweep after all stages of a receiver."""
        return [
            chain.receive(
                Received(
                    paths=paths,
                    pulses=pulses,
                    grid=chain.grid(sweep),
                    sweep=index,
                    sweeps=len(sweeps),
                    transmit_power_w=self.transmit_power_w,
                    noise_power_w=self.noise_power_w,
                    seed=self.seed,
                    channel=channel,
                )
            )
            for index, sweep in enumerate(sweeps)
        ]
