"""Real ground for tests and studies, which no file of this project may be: public files, with checksums and licences.

    uv run python tests/real_files.py    # fetches them into the user's cache, or into SIONNA_RADAR_DATA

Tests never fetch: they take what is there, and are skipped without.
"""

from pathlib import Path

import pooch
import pytest

# Within GitHub: repository, commit, path. Both licences allow use; the files are not passed on.
TAHOE = "JoshOBrien/gdalUtilities/3d87b464354ad2f473b67b917a8b3d1bc7d58008/inst/extdata/tahoe_lidar_bareearth.tif"
TOPOGRAPHY = "r-lidar/lidR/d185a7eb3d8de52272c9c60500fd104b97197cf3/inst/extdata/Topography.laz"
HILLSIDE = "EarthObservation/RVT_py/bab109c409fedf77ccec7de5fd84c48b791df3d2/test_data/TM1_564_146.tif"
MOUNTAIN = "harish2rb/pyGeoNet/d29805fb16b4c8fecb19dc92ca7a7a52b705c547/data/skunk_test1.tif"
FILES = pooch.create(
    path=pooch.os_cache("sionna_radar"),
    base_url="https://raw.githubusercontent.com/",
    env="SIONNA_RADAR_DATA",
    registry={
        # GPL-2 or later. Bare ground by lidar at 0.5 m, 190 x 240 m above Lake Tahoe (J. Greenberg).
        TAHOE: "sha256:c5d29f6c185560ff58a481f253a9e6432ac1fdd577bec5fb3471365830a818f0",
        # GPL-3. Points of the ground and of trees, 290 x 290 m of hills in Quebec.
        TOPOGRAPHY: "sha256:3016d0d654a7b38f5589c1f60c302a50045b9bba6b2047b2e47a474e9ac8c149",
        # Apache-2.0. Bare ground by lidar at 1 m, 1 x 1 km of hills, a road and banks in Slovenia.
        HILLSIDE: "sha256:48dc765313e22b0dc4382b51c845812b4b2aed867646530292b44178807055f3",
        # GPL-3. Bare ground by lidar at 1 m, 920 x 850 m of steep gullied slopes, Skunk Creek.
        MOUNTAIN: "sha256:5683b51fcfb93633c5cd57f76031eec28b2b3100577df6299165d1dde03e5cb5",
    },
)


def place_of(name: str) -> Path:
    """Return where a file of the registry is, or would be."""
    return Path(FILES.abspath, name)


def real_file(name: str) -> Path:
    """Return a file of the registry as it was fetched; skip the test where it is missing."""
    path = place_of(name)
    if not path.exists():
        pytest.skip("`python tests/real_files.py` fetches it")
    assert f"sha256:{pooch.file_hash(path)}" == FILES.registry[name], f"{path} is not the file meant; remove it"
    return path


if __name__ == "__main__":
    for each in FILES.registry:
        print(FILES.fetch(each, progressbar=False))
