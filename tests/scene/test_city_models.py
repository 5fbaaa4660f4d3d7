"""City models are refused by their content with the way to convert them, wherever a file of a site is named."""

import json

import pytest

from sionna_radar import parse_scenario, prepare
from sionna_radar.foundation.city_models import HEAD_BYTES, refuse_city_model
from sionna_radar.foundation.errors import InputFileError
from sionna_radar.scenario.loading import scenario_from

CITY = {"CityObjects": {"house": {"type": "Building"}}, "vertices": [[0, 0, 0]] * HEAD_BYTES, "version": "2.0"}
GML = 'xmlns:bldg="http://www.opengis.net/citygml/building/2.0"'
FILES = {
    "first.city.json": json.dumps({"type": "CityJSON"} | CITY),
    "last.city.json": json.dumps(CITY | {"type": "CityJSON"}),
    "named.geojson": json.dumps(CITY | {"type": "CityJSON"}, indent=1),
    "marked.json": '\ufeff {"metadata": {"title": "a \\" {"}, "type" : "CityJSON"}',
    "lines.city.jsonl": '{"type":"CityJSONFeature","CityObjects":{}}\n',
    "named.obj": '{"type": "CityJSON"}',
    "named.tif": '{"type": "CityJSON"}',
    "a.gml": '<?xml version="1.0"?>\n<core:CityModel xmlns:core="http://www.opengis.net/citygml/2.0"/>',
    "b.xml": '<CityModel xmlns="http://www.opengis.net/citygml/3.0"/>',
    "long.xml": f"<!--{'licence ' * 1000}--><CityModel>",
    "served.gml": f'<wfs:FeatureCollection xmlns:wfs="http://www.opengis.net/wfs/2.0" {GML}>',
    "named.shp": f"<CityModel {GML}/>",
}
OTHERS = {
    "a.geojson": '{"type": "FeatureCollection", "features": [{"properties": {"type": "CityJSON"}}]}',
    "b.json": '{"name": "\\"type\\": \\"CityJSON\\"", "was": ["type", "CityJSON"]}',
    "c.json": "{",
    "d.gml": "<gml/>",
    "e.xml": "<scene><!-- xmlns='http://www.opengis.net/citygml/2.0' <CityModel> --></scene>",
    "f.obj": "# CityModel, from CityJSON\nv 0 0 0\n",
    "g.ply": "",
}
PLAN = {"platform": {"altitude_m": 50.0, "speed_mps": 10.0}, "radar": {"snr_db": 30.0}, "terrain": {"kind": "flat"}}
KEYS = {
    "footprints.0.path": lambda path: {"footprints": [{"path": path, "height": "height"}]},
    "terrain.cover_vector.path": lambda path: {
        "terrain": {"kind": "flat", "cover_vector": {"path": path, "attribute": "use", "classes": {"a": "ground"}}}
    },
    "objects.0.path": lambda path: {"objects": [{"path": path, "position_m": [0.0, 0.0]}]},
    "terrain.path": lambda path: {"terrain": {"kind": "mesh", "path": path}},
    "terrain.path ": lambda path: {"terrain": {"kind": "raster", "path": path}},
    "terrain.path  ": lambda path: {"terrain": {"kind": "points", "path": path}},
    "terrain.cover_raster.path": lambda path: {
        "terrain": {"kind": "flat", "cover_raster": {"path": path, "classes": {"1": "ground"}}}
    },
}


def kind_of(text: str) -> str:
    return "CityGML" if text.startswith("<") else "CityJSON"


@pytest.mark.parametrize("key", KEYS)
@pytest.mark.parametrize("name", ["last.city.json", "served.gml"])
def test_every_key_refuses_a_city_model_with_its_conversion(tmp_path, key, name):
    path = tmp_path / name
    path.write_text(FILES[name], encoding="utf-8")
    with pytest.raises(InputFileError) as refused:
        prepare(parse_scenario(PLAN | KEYS[key](str(path))))
    assert str(refused.value).startswith(f"{key.strip()} = {path} is {kind_of(FILES[name])}; convert it with ")
    assert "cjio" in str(refused.value)
    assert str(refused.value).endswith("and give it as [[objects]], path = 'buildings.obj', centre = 'box'")


@pytest.mark.parametrize("name", FILES)
def test_a_city_model_is_known_by_its_content(tmp_path, name):
    (tmp_path / name).write_text(FILES[name], encoding="utf-8")
    with pytest.raises(InputFileError, match=f"is {kind_of(FILES[name])}; convert it with"):
        refuse_city_model(tmp_path / name, "key =")
    with pytest.raises(InputFileError, match=f"^--from .* is {kind_of(FILES[name])}; convert it with"):
        scenario_from([str(tmp_path / name)], tmp_path)


@pytest.mark.parametrize("name", OTHERS)
def test_other_files_are_not_taken_for_one(tmp_path, name):
    (tmp_path / name).write_text(OTHERS[name], encoding="utf-8")
    assert refuse_city_model(tmp_path / name, "key =") is None  # it raises for a city model
