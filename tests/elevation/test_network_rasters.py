"""Rasters at addresses: refused unless allowed, and then read from a server, here one of this machine."""

import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest

from elevation_files import from_origin, write_heights
from sionna_radar.elevation.elevation_file import opened_file
from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import allow_network
from sionna_radar.scenario import load_scenario
from sionna_radar.scenario.terrain import RasterTerrain


class Ranges(SimpleHTTPRequestHandler):
    """A server of files that answers requests for a part of one, as those of cloud-optimised files must."""

    asked: list[str]

    def __init__(self, *given, asked, **named):
        self.asked = asked
        super().__init__(*given, **named)

    def log_message(self, *_):
        pass

    def do_GET(self):
        self.asked.append(self.path)
        with open(self.translate_path(self.path), "rb") as file:  # noqa: PTH123
            content = file.read()
        wanted = self.headers.get("Range")
        first, last = 0, len(content) - 1
        if wanted:
            first, last = (int(part or last) for part in wanted.removeprefix("bytes=").split("-"))
        body = content[first : last + 1]
        self.send_response(206 if wanted else 200)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Accept-Ranges", "bytes")
        if wanted:
            self.send_header("Content-Range", f"bytes {first}-{first + len(body) - 1}/{len(content)}")
        self.end_headers()
        self.wfile.write(body)


@pytest.fixture
def served(tmp_path):
    asked: list[str] = []
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Ranges, directory=str(tmp_path), asked=asked))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield tmp_path, f"http://127.0.0.1:{server.server_port}", asked
    server.shutdown()
    server.server_close()


def test_an_address_is_read_only_when_allowed(served):
    folder, address, asked = served
    heights = np.add.outer(np.arange(40.0), np.arange(50.0))
    write_heights(folder / "dem.tif", heights, from_origin(500_000.0, 5_000_000.0, 10.0, 10.0))
    url = f"{address}/dem.tif"
    with pytest.raises(InputFileError, match=r"is on the network; allow it with --allow-network"), opened_file(url):
        pass
    assert asked == []
    with allow_network(), opened_file(url) as dataset:
        np.testing.assert_array_equal(dataset.read(1), heights.astype(dataset.dtypes[0]))
    assert asked
    with allow_network(), pytest.raises(InputFileError, match="cannot be read as a raster"), opened_file(url + "x"):
        pass


@pytest.mark.parametrize("address", ["/vsicurl/http://127.0.0.1/a.tif", "/vsizip/a.zip/a.tif", "ftp://127.0.0.1/a.tif"])
def test_only_known_schemes_are_reached(address):
    with pytest.raises(InputFileError, match="is on the network"), opened_file(address):
        pass
    with allow_network(), pytest.raises(InputFileError, match="is not a readable address"), opened_file(address):
        pass


def test_a_scenario_keeps_an_address_as_it_is_written(tmp_path):
    url = "https://example.org/a/dem.tif"
    scenario = tmp_path / "far.toml"
    scenario.write_text(
        f'[terrain]\nkind="raster"\npath="{url}"\n[platform]\naltitude_m=50\nspeed_mps=5\n[radar]\nsnr_db=30\n',
        encoding="utf-8",
    )
    terrain = load_scenario(scenario).terrain
    assert terrain.path == url
    assert RasterTerrain(path=tmp_path / "a.tif").path == tmp_path / "a.tif"
