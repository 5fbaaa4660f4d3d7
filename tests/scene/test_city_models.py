"""City models are refused with the way to convert them, wherever a model or outlines are named."""

import pytest

from sionna_radar.foundation.errors import InputFileError
from sionna_radar.scene.mesh_files.reader import read_mesh
from sionna_radar.scene.vector_file import read_polygons

FILES = {
    "a.city.json": '{"type": "CityJSON", "version": "2.0", "CityObjects": {}, "vertices": []}',
    "b.city.jsonl": '{"type":"CityJSONFeature","CityObjects":{}}\n',
    "c.gml": '<?xml version="1.0"?>\n<core:CityModel xmlns:core="http://www.opengis.net/citygml/2.0"/>',
    "d.xml": '<CityModel xmlns="http://www.opengis.net/citygml/3.0"/>',
}


@pytest.mark.parametrize("name", FILES)
def test_a_city_model_is_refused_with_its_conversion(tmp_path, name):
    (tmp_path / name).write_text(FILES[name])
    kind = "CityJSON" if "json" in name else "CityGML"
    with pytest.raises(InputFileError, match=rf"is {kind}; convert it with .*cjio .* export obj .*\[\[objects\]\]"):
        read_mesh(tmp_path / name, "objects.0.path")
    with pytest.raises(InputFileError, match=f"is {kind}; convert"):
        read_polygons(tmp_path / name, "footprints.0", (), None, (0.0, 0.0, 1.0, 1.0))


@pytest.mark.parametrize(("name", "text"), [("e.geojson", '{"type": "FeatureCollection"}'), ("f.gml", "<gml/>")])
def test_other_files_are_not_taken_for_one(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputFileError) as refused:
        read_mesh(tmp_path / name, "objects.0.path")
    assert "City" not in str(refused.value)
