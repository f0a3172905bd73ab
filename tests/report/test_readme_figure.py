"""docs/figure.py: the figure of the README."""

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_both_measures_are_drawn_in_the_colours_of_the_strategies(make_job, tmp_path, monkeypatch):
    for name, learned in {"softmax": [60, 70, 80], "argmax": [90, 200, None]}.items():
        make_job(tmp_path, name, [150, 900, 1000], strategy=name, learned=learned, stop_on="never")
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    monkeypatch.delitem(sys.modules, "figure", raising=False)
    import figure

    svg = figure.draw(tmp_path)
    assert svg == figure.draw(tmp_path)
    assert "not yet passed, and that have not yet learned" in svg
    assert svg.count('id="survival-axes_') == 2
    for color in ("a8328c", "d55e00"):
        assert svg.count(f"stroke: var(--c{color})") >= 4
    kept = figure.OUT.read_text(encoding="utf-8")
    assert "prefers-color-scheme:dark" in svg
    assert kept[: kept.index("<style>")] == svg[: svg.index("<style>")]
