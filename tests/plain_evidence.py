"""Evidence for and against heights with whole arrays for one pulse after the other: the slow oracle of its kernels."""

import numpy as np

from sionna_radar.mapping.options import STEPPED


def support(sightings, pulse, patch_m, reflectivity, typical, alternatives):
    """Return the log-likelihood ratio of patches (..., 3) of a reflectivity, in nepers; 0 outside the main lobe."""
    profiles, pose = sightings.profiles, sightings.pose
    power, noise = profiles.values(pulse), float(profiles.noise[pulse])
    away = patch_m - pose.position_m[pulse]
    range_m = np.linalg.norm(away, axis=-1)
    direction = away / range_m[..., None]
    gain = sightings.beam.two_way(direction @ pose.R_world_antenna[pulse])
    rate = -direction @ pose.velocity_mps[pulse]
    apparent = range_m + sightings.doppler * sightings.chirp.doppler_range_m(rate.ravel()).reshape(rate.shape)
    cell = np.round(apparent / profiles.cell_m).astype(int) - int(profiles.first[pulse])
    edged = np.concatenate([[noise, noise], np.maximum(power, noise), [noise, noise]])
    place = np.clip(cell, -1, len(power)) + 2
    before = np.maximum.accumulate(edged)[place - 1]
    most = np.maximum(np.maximum(edged[place - 1], edged[place]), edged[np.minimum(place + 1, len(edged) - 1)])
    mean = noise + reflectivity * gain
    short, ratio = np.minimum(most / mean, 1.0), edged[place] / mean
    fits = np.maximum(np.log(ratio) - ratio + np.log(alternatives), 0.0)
    seen = before < noise + typical * gain
    found = (np.log(short) - short + 1) * seen + fits * ((cell >= 0) & (cell < len(power)) & (gain > STEPPED.min_gain))
    return np.where(gain > 0, found, 0.0)


def evidence(sightings, grid, base_m, level_m, bright):
    """Return the evidence against heights over the cells of a grid."""
    height = base_m[..., None] + level_m
    patch = np.stack(np.broadcast_arrays(grid.x_m[None, :, None], grid.y_m[:, None, None], height), axis=-1)
    total = np.zeros((len(bright.step), *height.shape))
    for pulse in range(len(sightings)):
        for number, reflectivity in enumerate(bright.step):
            total[number] -= support(sightings, pulse, patch, reflectivity, bright.typical, bright.alternatives)
    return total.min(axis=0)
