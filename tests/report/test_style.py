from itertools import combinations

from trl_explore.report.style import (
    DARK_PAPER,
    FURTHER,
    KNOWN,
    PAPER,
    contrast,
    dark_variant,
    styles,
)


def test_a_strategy_looks_the_same_beside_whatever_others():
    alone = styles(["softmax"])[0]
    among = dict(zip(["random", "softmax"], styles(["random", "softmax"]), strict=True))
    assert alone == among["softmax"] == KNOWN["softmax"]


def test_twelve_strategies_are_told_apart_without_colour():
    for known in (list(KNOWN)[:5], list(KNOWN)[-5:]):
        looks = styles([*known, *(f"other{k}" for k in range(7))])
        assert len({(s.marker, s.line) for s in looks}) == 12
        assert len({s.color for s in looks}) == 12


def test_all_known_strategies_and_seven_others_are_told_apart():
    looks = styles([*KNOWN, *(f"other{k}" for k in range(7))])
    assert looks[: len(KNOWN)] == list(KNOWN.values())
    assert len({(s.marker, s.line) for s in looks}) == len({s.color for s in looks}) == len(looks)


def test_twelve_values_of_one_strategy_are_told_apart_without_colour():
    looks = styles(["softmax"] * 12)
    assert len({(s.marker, s.line) for s in looks}) == 12
    assert len({s.color for s in looks}) == 12


def test_four_values_each_of_three_strategies_are_told_apart_without_colour():
    looks = styles(["softmax", "argmax", "random"] * 4)
    assert len({(s.marker, s.line) for s in looks}) == 12


def test_colours_stand_out_from_light_and_dark_paper():
    for style in (*KNOWN.values(), *FURTHER):
        assert contrast(style.color, PAPER) >= 3.0
        assert contrast(dark_variant(style.color), DARK_PAPER) >= 3.9


def test_colours_differ_for_readers_without_red_or_green_cones():
    # Machado, Oliveira & Fernandes (2009), severity 1, on linear RGB.
    deutan = [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
              [-0.011820, 0.042940, 0.968881]]  # fmt: skip
    protan = [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
              [-0.003882, -0.048116, 1.051998]]  # fmt: skip
    for matrix in (deutan, protan):
        seen = {n: [sum(m * c for m, c in zip(row, _linear(s.color), strict=True))
                    for row in matrix] for n, s in KNOWN.items()}  # fmt: skip
        for a, b in combinations(seen, 2):
            distance = sum((x - y) ** 2 for x, y in zip(seen[a], seen[b], strict=True)) ** 0.5
            assert distance > 0.04, (a, b, distance)


def _linear(color: str) -> list[float]:
    values = [int(color[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    return [v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in values]
