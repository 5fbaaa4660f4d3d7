"""The document of a study, declared once: its record as JSON, tables, sentences, figures, further files and a page."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from sionna_radar.foundation.progress import advance, stage
from sionna_radar.report.files.contents import FIGURES, Report, csv_text, jsonable, strict_json, write_page, write_text
from sionna_radar.report.files.folder import write_folder
from sionna_radar.report.terminal import NONE, console, number, print_whole, say, table_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.table import Table

    from sionna_radar.report.page.markup import TableCell

Record = TypeVar("Record")
Row = TypeVar("Row")


@dataclass(frozen=True, kw_only=True)
class StudyDocument(Generic[Record]):
    """What a study shows and writes of its record.

    marker: file that every result of this kind contains, and that identifies the kind; the numbers, or one of `texts`.
    suffix: of the default output folder's name.
    numbers: the quantities by name, of any type that `jsonable` converts; None without a file of numbers.
    opening: sentences above the tables.
    tables: for the console and for notebooks.
    lines: sentences below the tables.
    figures: drawings by name, for the folder `figures`.
    notebook: names of the figures that notebooks show, if the record has them.
    texts: contents of further files by name; None leaves one out.
    files: write further files, such as rasters, into a folder.
    page: HTML of the page `report.html`; None without one.
    """

    marker: str
    suffix: str
    numbers: Callable[[Record], Mapping[str, Any]] | None = None
    opening: Callable[[Record], Iterable[str]] = lambda _: ()
    tables: Callable[[Record], Sequence["Table"]] = lambda _: ()
    lines: Callable[[Record], Iterable[str]] = lambda _: ()
    figures: "Callable[[Record], Mapping[str, Callable[[Record], Figure]]]" = lambda _: {}
    notebook: Sequence[str] = ()
    texts: Mapping[str, Callable[[Record], str | None]] = field(default_factory=dict)
    files: Sequence[Callable[[Record, Path], object]] = ()
    page: Callable[[Record], str] | None = None

    def content(self, record: Record) -> dict[str, Any]:
        """Return the numbers as the file `marker` holds them."""
        return {} if self.numbers is None else {key: jsonable(value) for key, value in self.numbers(record).items()}

    def write(self, record: Record, directory: Path, *, report: Report = Report.PAGE) -> list[Path]:
        """Write all files into a directory, completely or not at all, and return them; see `write_folder`.

        report: selects the page, `report.html`.
        """
        return write_folder(directory, self.marker, partial(self._fill, record, report))

    def _fill(self, record: Record, report: Report, folder: Path) -> None:
        page = self.page if report is Report.PAGE else None
        steps: list[Callable[[], object]] = [
            *([lambda: write_text(folder / self.marker, strict_json(self.content(record)))] if self.numbers else []),
            *(partial(_write_text, folder / name, text, record) for name, text in self.texts.items()),
            *(partial(write, record, folder) for write in self.files),
            partial(self._draw, record, folder),
            *([lambda: write_page(folder / "report.html", partial(page, record))] if page else []),
        ]
        with stage("writing", len(steps)):
            for step in steps:
                step()
                advance()

    def _draw(self, record: Record, folder: Path) -> None:
        figures = self.figures(record)
        if figures:
            # Slow to import, and not needed to show a record.
            from sionna_radar.report.drawing import save_figures

            save_figures(record, figures, folder / FIGURES)

    def show(self, record: Record) -> None:
        """Print the tables, with the sentences above and below them."""
        say(*self.opening(record))
        for table in self.tables(record):
            # Names with sentences fold; a row of numbers that is folded is hard to read.
            print_whole(table) if table.show_header else console().print(table)
        say(*self.lines(record))

    def views(self, record: Record) -> "list[Table | Figure]":
        """Return the tables and the named figures for a notebook."""
        drawings = self.figures(record)
        return [*self.tables(record), *(drawings[name](record) for name in self.notebook if name in drawings)]


@dataclass(frozen=True, kw_only=True)
class Column(Generic[Row]):
    """One quantity of the rows of a study: a key in files, and a column of tables.

    key: in JSON and CSV; "" for a column of tables alone.
    heading: of the column; None for a key of files alone.
    form: format specification of a number in tables; "" for text, which is flush left.
    unit: after each number in tables.
    value: of a row; by default its entry or attribute `key`.
    text: of a row in tables; by default its value as a number with its unit, as yes or no, or as it is.
    console: whether the terminal shows the column, not only pages.
    """

    key: str = ""
    heading: str | None = None
    form: str = ""
    unit: str = ""
    value: Callable[[Row], Any] | None = None
    text: Callable[[Row], str] | None = None
    console: bool = True

    def of(self, row: Row) -> Any:
        """Return the value of a row."""
        if self.value is not None:
            return self.value(row)
        return row[self.key] if isinstance(row, Mapping) else getattr(row, self.key)

    def shown(self, row: Row) -> str:
        """Return the text of a row in tables."""
        if self.text is not None:
            return self.text(row)
        value = self.of(row)
        if isinstance(value, bool):
            return "yes" if value else "no"
        return NONE if value is None else number(value, self.form, self.unit) if self.form else str(value)


@dataclass(frozen=True)
class Columns(Generic[Row]):
    """The quantities of rows, in order: rows of JSON and CSV files, and of tables on the console and on pages."""

    columns: Sequence[Column[Row]]

    def numbers(self, rows: Iterable[Row]) -> list[dict[str, Any]]:
        """Return the rows as JSON objects."""
        return [{column.key: column.of(row) for column in self.columns if column.key} for row in rows]

    def csv(self, rows: Iterable[Row], keys: Sequence[str], form: str) -> str:
        """Return some keys of the rows as CSV; numbers have a format specification, and None is an empty cell."""
        chosen = [column for key in keys for column in self.columns if column.key == key]
        return csv_text(keys, ([_cell(column.of(row), form) for column in chosen] for row in rows))

    def table(self, title: str, rows: Iterable[Row]) -> "Table":
        """Return the table for the console and notebooks."""
        shown = [column for column in self.columns if column.console and column.heading is not None]
        left = [str(column.heading) for column in shown if not column.form and column.text is None]
        texts = ([column.shown(row) for column in shown] for row in rows)
        return table_of(title, [str(column.heading) for column in shown], texts, left=left)

    @property
    def heads(self) -> list[str]:
        """Headings of the table of a page."""
        shown = [column.heading for column in self.columns if column.heading is not None]
        return [heading[:1].upper() + heading[1:] for heading in shown]

    def cells(self, rows: Iterable[Row], place: str) -> "list[list[TableCell | str]]":
        """Return the table of a page; numbers have their keys in the document, below that of the rows, `place`."""
        # Slow to import, and needed by pages alone.
        from sionna_radar.report.page.markup import TableCell

        shown = [column for column in self.columns if column.heading is not None]
        return [
            [
                TableCell(column.shown(row), f"{place}{count}.{column.key}", column.of(row))
                if column.key and (column.form or column.text)
                else column.shown(row)
                for column in shown
            ]
            for count, row in enumerate(rows)
        ]


def _write_text(path: Path, text_of: Callable[[Record], str | None], record: Record) -> None:
    text = text_of(record)
    if text is not None:
        write_text(path, text)


def _cell(value: Any, form: str) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:{form}}" if value == value else ""
    return "" if value is None else str(value)
