"""Modules with arrays, and their frames over point targets, for tests."""

import numpy as np
from scipy.constants import speed_of_light

from sionna_radar.detection.angle.array_arrival import ArrayEstimator
from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.flight.pulses import Pose
from sionna_radar.radar.chirp import Chirp
from sionna_radar.radar.mimo_array import MimoArray, code_of
from sionna_radar.signal.array_beats import FramePaths, array_beats

CHIRP = Chirp(carrier_hz=77e9, bandwidth_hz=400e6, rate_hz=16e3, samples=64, sampling="iq")
DOWN = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
HEIGHT_M = 15.0


def line_of(transmitters, receivers, blocks=16, code="tdm", spacing=0.5, chirp=CHIRP, **keys):
    """Return a filled line of virtual elements to the left: receivers spaced evenly, transmitters by all of them."""
    places = []
    for count, step in ((transmitters, receivers * spacing), (receivers, spacing)):
        place = np.zeros((count, 3))
        place[:, 1] = (np.arange(count) - (count - 1) / 2) * step * chirp.wavelength_m
        places.append(place)
    return MimoArray(
        transmitter_m=places[0],
        receiver_m=places[1],
        code=code_of(code, transmitters),
        blocks=blocks,
        period_s=1 / chirp.rate_hz,
        wavelength_m=chirp.wavelength_m,
        direction=chirp.direction,
        **keys,
    )


def estimator_of(array, chirp=CHIRP, window="hann", **keys):
    """Return an estimator of single cells."""
    settings = {
        "rate_window": window,
        "min_range_m": 2.0,
        "false_alarm_probability": 1e-6,
        "dynamic_range_db": 25.0,
        "half_view_rad": np.deg2rad(60.0),
        "average_cells": (1, 1),
        "max_sigma_m": 5.0,
    }
    return ArrayEstimator(analyser=SpectrumAnalyser(chirp, window, 1), array=array, **{**settings, **keys})


def poses(array, velocity_mps=(10.0, 0.0, 0.0), time_s=None):
    """Return the poses of a module that looks down, at the chirps of a frame."""
    if time_s is None:
        time_s = (np.arange(array.chirps) - (array.chirps - 1) / 2) * array.period_s
    velocity = np.array(velocity_mps)
    return Pose(
        position_m=np.array([0.0, 0.0, HEIGHT_M]) + np.outer(time_s, velocity),
        velocity_mps=np.tile(velocity, (len(time_s), 1)),
        R_world_antenna=np.tile(DOWN, (len(time_s), 1, 1)),
    )


def middle(velocity_mps=(10.0, 0.0, 0.0)):
    """Return the pose in the middle of a frame."""
    return poses(None, velocity_mps, np.zeros(1))


def seen_at(estimator, row, cell, cosine_left, velocity_mps=(10.0, 0.0, 0.0), fold=0):
    """Return the place of a target in the middle of a cell of a map, by its direction cosine to the left."""
    array, speed = estimator.array, np.linalg.norm(velocity_mps)
    rate = row * array.rate_cell_mps * array.direction + 2 * fold * array.highest_rate_mps
    # The motion is the antenna's up axis.
    up = -rate / speed
    direction = np.array([np.sqrt(1 - cosine_left**2 - up**2), cosine_left, up])
    chirp = estimator.analyser.chirp
    range_m = cell * chirp.range_resolution_m - float(chirp.doppler_range_m(np.array([rate]))[0])
    return middle().position_m[0] + range_m * DOWN @ direction, direction


def frame_of(array, place_m, gain, chirp=CHIRP, velocity_mps=(10.0, 0.0, 0.0)):
    """Return the beat signals of still point targets, without noise."""
    paths = FramePaths(
        place_m=np.atleast_2d(np.asarray(place_m, dtype=float)),
        beyond_m=np.zeros(len(gain)),
        drift_mps=np.zeros(len(gain)),
        gain=np.asarray(gain, dtype=np.complex128),
    )
    return array_beats(paths, poses(array, velocity_mps), array, chirp)


def plain_frame(array, place_m, gain, chirp=CHIRP, velocity_mps=(10.0, 0.0, 0.0)):
    """Return the same, one exponential after another, with the motion within each chirp."""
    pose, time_s = poses(array, velocity_mps), chirp.sample_time_s
    velocity = np.array(velocity_mps)
    beats = np.zeros((array.chirps, len(array.receiver_m), chirp.samples), dtype=np.complex128)
    for m in range(array.chirps):
        away = place_m[:, None] - pose.position_m[m] - time_s[:, None] * velocity
        for i, transmitter in enumerate(array.transmitter_m):
            factor = array.sent_code[m % len(array.code), i]
            for k, receiver in enumerate(array.receiver_m):
                way = sum(np.linalg.norm(away - DOWN @ element, axis=2) for element in (transmitter, receiver))
                delay = way / speed_of_light
                phase = (chirp.carrier_hz + chirp.slope_hz_s * time_s) * delay - chirp.slope_hz_s * delay**2 / 2
                turned = np.exp(2j * np.pi * chirp.direction * phase)
                wave = np.conj(gain) if chirp.direction > 0 else gain
                beats[m, k] += factor * (wave @ turned)
    return beats
