"""What results show in a notebook: their numbers, a picture, and nothing that the page takes for markup."""

import base64
import io
import re
from dataclasses import replace

from matplotlib.image import imread

from sionna_radar.survey.result import Survey


def test_a_survey_shows_its_error_and_its_dem(survey: Survey) -> None:
    page = survey._repr_html_()
    assert f"{survey.lit_error.rms_m:.3f} m" in re.sub(r"<[^>]*>", "", page)
    (picture,) = re.findall(r"data:image/png;base64,([A-Za-z0-9+/=]+)", page)
    image = imread(io.BytesIO(base64.b64decode(picture)), format="png")
    assert image[..., :3].std() > 0.05, "a picture of one colour shows nothing"


def test_a_survey_without_an_echo_is_shown_too(empty: Survey) -> None:
    assert "data:image/png" in empty._repr_html_()


def test_warnings_stand_under_the_picture_and_are_text(survey: Survey) -> None:
    page = replace(survey, warnings=("rain <b>falls</b> & falls",))._repr_html_()
    assert page.rstrip().endswith("<p>warning: rain &lt;b&gt;falls&lt;/b&gt; &amp; falls</p>")


def test_what_has_no_table_is_shown_as_it_prints(survey: Survey) -> None:
    assert survey.prepared._repr_html_() == f"<pre>{survey.prepared!r}</pre>"
