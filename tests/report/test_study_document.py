"""A declared document: one record as JSON, CSV, tables, sentences, figures, files and a page."""

import json
from dataclasses import dataclass

import numpy as np
import pytest

from sionna_radar.report.drawing import ReportFigure
from sionna_radar.report.files.contents import Report, jsonable
from sionna_radar.report.page.markup import TableCell, command_line
from sionna_radar.report.study_document import Column, Columns, StudyDocument
from sionna_radar.scenario import load_scenario


@dataclass(frozen=True, kw_only=True)
class Level:
    cover: str
    sigma0_db: float
    fitted: bool

    @property
    def excess_db(self) -> float:
        return self.sigma0_db + 20.0


ROWS = (
    Level(cover="grass", sigma0_db=-18.25, fitted=True),
    Level(cover="snow, wet", sigma0_db=float("nan"), fitted=False),
)
LEVELS = Columns[Level](
    [
        Column(key="cover", heading="cover"),
        Column(key="sigma0_db", heading="level", form="+.1f", unit=" dB"),
        Column(key="excess_db"),
        Column(key="fitted", heading="fitted", console=False),
        Column(heading="sign", text=lambda row: "-" if row.sigma0_db < 0 else "+"),
    ]
)


def texts(table) -> list[list[str]]:
    return [[str(column.header), *column.cells] for column in table.columns]


def test_columns_are_keys_of_files_and_columns_of_tables():
    rows = LEVELS.numbers(ROWS)
    assert [list(row) for row in rows] == [["cover", "sigma0_db", "excess_db", "fitted"]] * 2
    assert rows[0]["excess_db"] == pytest.approx(1.75)
    assert LEVELS.csv(ROWS, ["fitted", "cover", "sigma0_db"], ".3g") == (
        'fitted,cover,sigma0_db\ntrue,grass,-18.2\nfalse,"snow, wet",\n'
    )
    table = LEVELS.table("Levels", ROWS)
    assert texts(table) == [["cover", "grass", "snow, wet"], ["level", "-18.2 dB", "-"], ["sign", "-", "+"]]
    assert [column.justify for column in table.columns] == ["left", "right", "right"]
    assert LEVELS.heads == ["Cover", "Level", "Fitted", "Sign"]
    first, second = LEVELS.cells(ROWS, "levels.")
    assert first == ["grass", TableCell("-18.2 dB", "levels.0.sigma0_db", -18.25), "yes", "-"]
    assert second[1].key == "levels.1.sigma0_db"


def test_columns_of_mappings_read_their_entries():
    columns = Columns[dict]([Column(key="n", heading="n", form="d"), Column(key="why", heading="why")])
    assert texts(columns.table("", [{"n": 1200, "why": None}])) == [["n", "1200"], ["why", "-"]]


def test_any_record_has_a_strict_json_form():
    scenario = load_scenario("hills")
    record = {"rows": ROWS, "array": np.array([[1.0, np.inf]]), "count": np.int64(3), "scenario": scenario, "no": None}
    found = jsonable(record)
    assert found["rows"][0] == {"cover": "grass", "sigma0_db": -18.25, "fitted": True}
    assert found["rows"][1]["sigma0_db"] is None
    assert found["array"] == [[1.0, None]]
    assert json.loads(json.dumps(found, allow_nan=False))["count"] == 3
    assert found["scenario"]["radar"]["bandwidth_hz"] == scenario.radar.bandwidth_hz


DOCUMENT = StudyDocument[tuple[Level, ...]](
    marker="levels.json",
    suffix="_levels",
    numbers=lambda levels: {"levels": LEVELS.numbers(levels)},
    opening=lambda levels: [f"{len(levels)} levels"],
    tables=lambda levels: [LEVELS.table("Levels", levels)],
    lines=lambda levels: [f"{level.cover}: not fitted" for level in levels if not level.fitted],
    figures=lambda levels: {"levels": lambda _: ReportFigure(figsize=(1.0, 1.0))} if len(levels) > 1 else {},
    notebook=["levels"],
    texts={"levels.csv": lambda levels: LEVELS.csv(levels, ["cover"], ""), "none.txt": lambda _: None},
    files=[lambda levels, folder: (folder / "count.bin").write_bytes(bytes([len(levels)]))],
    page=lambda levels: f"<p>{len(levels)}</p>",
)


def test_a_document_writes_all_of_its_files(tmp_path):
    names = {path.relative_to(tmp_path).as_posix() for path in DOCUMENT.write(ROWS, tmp_path / "out")}
    files = {"levels.json", "levels.csv", "count.bin", "report.html", "figures/levels.png", "manifest.json"}
    assert names == {f"out/{name}" for name in files}
    assert json.loads((tmp_path / "out" / "levels.json").read_text()) == DOCUMENT.content(ROWS)
    assert DOCUMENT.content(ROWS)["levels"][1]["sigma0_db"] is None
    fewer = {path.name for path in DOCUMENT.write(ROWS[:1], tmp_path / "out", report=Report.NONE)}
    assert fewer == {"levels.json", "levels.csv", "count.bin", "manifest.json"}
    assert not (tmp_path / "out" / "report.html").exists()


def test_a_document_is_printed_and_viewed(capsys):
    DOCUMENT.show(ROWS)
    printed = capsys.readouterr().out
    assert printed.startswith("2 levels\n")
    assert printed.index("-18.2 dB") < printed.index("snow, wet: not fitted")
    assert [type(view).__name__ for view in DOCUMENT.views(ROWS)] == ["Table", "ReportFigure"]
    assert len(DOCUMENT.views(ROWS[:1])) == 1


def test_the_command_of_a_page_repeats_its_overrides():
    assert command_line(["twin", "a b.nc"], {"dem.method": "smooth", "radar.snr_db": 20.0}) == (
        "sionna-radar twin 'a b.nc' --set 'dem.method=\"smooth\"' --set radar.snr_db=20.0"
    )
