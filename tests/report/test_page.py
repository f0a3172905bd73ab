from __future__ import annotations

import re
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from trl_explore.report.page import episodes_per_iteration
from trl_explore.report.writing import build_report
from trl_explore.thesis import CLAIMS

EVIL = '<script>alert("x")</script>'


class Tags(HTMLParser):
    """Every tag with its attributes, and whether tags are balanced."""

    VOID = ("meta", "link", "br", "path", "use", "image", "rect", "hr")

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        if tag not in self.VOID:
            assert self.open.pop() == tag


def parse(html: str) -> Tags:
    parser = Tags()
    parser.feed(html)
    assert parser.open == []
    return parser


def test_the_page_loads_nothing_from_outside(made):
    tags = parse(made.html).tags
    for tag, attributes in tags:
        assert tag not in ("iframe", "img", "object", "embed", "base")
        for name in ("src", "href", "xlink:href", "action", "data"):
            value = attributes.get(name) or ""
            assert value == "" or value.startswith(("#", "data:")), (tag, value)
    assert "url(http" not in made.html
    assert "@import" not in made.html
    policy = next(a["content"] for t, a in tags if a.get("http-equiv"))
    assert policy is not None
    assert policy.startswith("default-src 'none'")


def test_ids_are_unique_and_every_link_inside_has_its_end(made):
    tags = parse(made.html).tags
    ids = Counter(a["id"] for _, a in tags if "id" in a)
    assert [name for name, count in ids.items() if count > 1] == []
    links = {a["href"] for t, a in tags if t == "a"} | {
        a["xlink:href"] for t, a in tags if t == "use"
    }
    assert all(link is not None and link[1:] in ids for link in links)
    clips = set(re.findall(r"url\(#([^)]+)\)", made.html))
    assert clips <= set(ids)


def test_every_figure_has_an_alternative_text_and_a_caption(made):
    tags = parse(made.html).tags
    drawings = [a for t, a in tags if t == "svg"]
    assert len(drawings) == len(list((made.out / "figures").glob("*.svg"))) > 15
    assert all(a["role"] == "img" and len(a["aria-label"] or "") > 60 for a in drawings)
    assert made.html.count("<figcaption>") == len(drawings)


def test_every_figure_stands_beside_the_page_as_svg_and_png(made):
    svg = {p.stem for p in (made.out / "figures").glob("*.svg")}
    png = {p.stem for p in (made.out / "figures").glob("*.png")}
    assert svg == png
    assert {"thesis-3_1-score", "thesis-3_2-iterations", "thesis-3_3-seconds",
            "epsilon_grid-2_1-score", "decay_grid-2_2-iterations", "decay_grid-2_3-score",
            "decay_grid-2_5-epsilon"} <= svg  # fmt: skip


def test_the_parts_come_in_the_order_of_a_reader_who_opens_it_cold(made):
    places = [made.html.index(f'id="{name}"') for name in (
        "answer", "claims-section", "thesis", "epsilon_grid", "decay_grid", "method", "provenance"
    )]  # fmt: skip
    assert places == sorted(places)


def test_every_statement_of_the_thesis_is_shown_with_its_definition(made):
    text = made.html.replace("&#39;", "'").replace("&gt;", ">").replace("&lt;", "<")
    for claim in CLAIMS:
        assert claim.statement.split("  ")[0] in text
        assert claim.place in text


def test_versions_seeds_commands_and_machine_are_told(made):
    provenance = made.html[made.html.index('id="provenance"') :]
    for fact in ("torch 2.13.0", "Linux x86_64", "1,000 iterations, 5,000 iterations",
                 "trl-explore train strategy=softmax", "FusedCollector"):  # fmt: skip
        assert fact in provenance
    assert "output_dir" not in provenance


def test_the_page_tells_what_was_tuned_and_what_was_shared(made):
    assert "tuned nothing for softmax" in made.html
    assert "epsilon_grid/epsilon=0.3 and thesis/epsilon_greedy (6)" in made.html


def test_text_from_a_configuration_is_escaped(tmp_path, make_job):
    make_job(tmp_path / "train", "one", [150, 200], strategy=EVIL, env=EVIL,
             parameters={"x": EVIL})  # fmt: skip
    make_job(tmp_path / "train", "two", [150, 1000], strategy="softmax", env=EVIL)
    damaged = make_job(tmp_path / "train", "<b>bad<b>", [150])
    (damaged / "trials.csv").write_text("a\n1\n")
    page, _ = build_report([tmp_path], tmp_path / "out")
    html = page.read_text(encoding="utf-8")
    assert "<script>alert" not in html
    assert "<b>bad" not in html
    assert "&lt;script&gt;alert" in html
    assert [t for t, _ in parse(html).tags].count("script") == 1


def test_an_experiment_cannot_lead_out_of_the_folder(tmp_path, make_job):
    make_job(tmp_path / "train", "one", [150, 200], experiment="../../evil")
    build_report([tmp_path / "train"], tmp_path / "a" / "b" / "out")
    made = [p for p in (tmp_path / "a").rglob("*") if p.is_file()]
    assert all((tmp_path / "a" / "b" / "out") in p.parents for p in made)


def test_a_report_made_twice_is_the_same_byte_for_byte(tmp_path, made):
    again = tmp_path / "again"
    build_report([made.study], again)
    assert contents(again) == contents(made.out)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_trials_too_few_to_find_anything_are_said_to_be(tmp_path, make_job):
    # Two strategies, one pair: the smallest p of a sign-flip test is 2 / 2^5 = 0.0625, 2 / 2^6.
    pages = []
    for n in (5, 6):
        sweep = tmp_path / f"{n}" / "train"
        make_job(sweep, "fast", [150 + k for k in range(n)], strategy="softmax")
        make_job(sweep, "slow", [900 + 3 * k for k in range(n)], strategy="epsilon_greedy")
        page, _ = build_report([sweep], tmp_path / f"out {n}")
        pages.append(page.read_text(encoding="utf-8"))
    assert "5 trials are too few" in pages[0]
    assert "needs at least 6 trials of each configuration" in pages[0]
    assert "5 trials per configuration cannot detect any difference" in pages[0]
    assert "too few" not in pages[1]
    assert "1 of 1 pair differs significantly" in pages[1]


def test_the_thesis_is_not_mentioned_where_nothing_of_it_applies(tmp_path, make_job):
    make_job(tmp_path / "train", "softmax", [150, 200])
    page, _ = build_report([tmp_path], tmp_path / "out")
    html = page.read_text(encoding="utf-8")
    assert "thesis" not in re.sub("<style.*?</style>", "", html, flags=re.S)
    assert "Not shown: seconds of single trials" in html


@pytest.mark.parametrize(
    ("per_update", "words"),
    [
        ([{}], "one episode"),
        ([{"episodes_per_update": 4}, {"episodes_per_update": 4}], "4 episodes"),
        ([{"episodes_per_update": 4}, {}], "one episode or 4 episodes"),
    ],
)
def test_an_iteration_is_as_many_episodes_as_were_run(per_update, words):
    outcomes: list[Any] = [SimpleNamespace(config=config) for config in per_update]
    assert episodes_per_iteration(outcomes) == words


def test_the_page_says_what_an_iteration_is(made):
    assert "One <b>iteration</b> is one episode and the update that follows." in made.html


def test_no_key_of_the_program_stands_in_a_sentence(made):
    """Keys stand in commands and in the names of folders; sentences use the words for readers."""
    html = re.sub(r"<(style|script|svg|pre|code)\b.*?</\1>", "", made.html, flags=re.S)
    for place in ("answer", "claims-section"):
        start = html.index(f'id="{place}"')
        text = re.sub("<[^>]*>", "", html[start : html.index("</section>", start)])
        assert "ε-greedy" in text
        assert not re.search(r"epsilon_greedy|decaying_|\bNoCorrection\b", text)
