"""Packed numbers come back as they went in, to the step that they were rounded to."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from packed_pages import array_of, unpacked
from sionna_radar.report.page.scene_data import EMPTY, Pack


@given(arrays(np.float64, (3, 4), elements=st.floats(-500, 500) | st.just(np.nan)), st.sampled_from([0.001, 0.1, 5.0]))
def test_rounded_values_come_back_within_half_a_step(values, step):
    pack = Pack()
    before, place, after = pack.exact(np.arange(3.0)), pack.rounded(values, step), pack.whole(np.array([7, -7]))
    document, arrays_ = unpacked(pack.text({"deep": [{"here": place}], "before": before, "after": after}))
    back = array_of(document["deep"][0]["here"], arrays_)
    known = values[np.isfinite(values)]
    coarse = max(step, np.ptp(known) / (EMPTY - 1)) if len(known) else step
    assert np.array_equal(np.isnan(back), np.isnan(values))
    assert np.nanmax(np.abs(back - values), initial=0.0) <= 0.5001 * coarse
    assert array_of(document["before"], arrays_).tolist() == [0.0, 1.0, 2.0]
    assert array_of(document["after"], arrays_).tolist() == [7.0, -7.0]


def test_text_in_a_pack_cannot_end_a_script():
    text = Pack().text({"name": "</script><script>alert(1)</script>", "none": float("nan")})
    assert "<" not in text
    assert unpacked(text)[0] == {"name": "</script><script>alert(1)</script>", "none": None}
