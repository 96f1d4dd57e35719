"""`stillroom train-vocabulary`."""

from collections.abc import Callable
from pathlib import Path

from stillroom.features.places.vocabulary import load_vocabulary

SMALL = ("--every", "4", "--branching", "6", "--depth", "3")


def test_a_vocabulary_is_made_with_its_card_and_can_be_grown(stillroom: Callable, tmp_path: Path) -> None:
    first, second = tmp_path / "first.vocabulary", tmp_path / "second.vocabulary"
    said = stillroom("train-vocabulary", "synthetic:walking,frames=8", "--out", str(first), *SMALL)
    assert said.code == 0
    vocabulary = load_vocabulary(first)
    assert f"{vocabulary.n_words} words from 2 images" in said.out
    card = (tmp_path / "first.vocabulary.txt").read_text(encoding="utf-8")
    assert vocabulary.digest in card
    assert "- synthetic_walking_sway_office_8_seed0: 2 images" in card
    n_used = int(card.split(" descriptors")[-2].rsplit(" ", 1)[-1])
    assert 500 < n_used < 2 * 1001  # those on the figures were left out
    grown = ("--grow", str(first), "--depth", "5", "--least", "10", "--every", "2")
    said = stillroom("train-vocabulary", "synthetic:empty,frames=4", "--out", str(second), *grown)
    assert said.code == 0
    assert load_vocabulary(second).n_words > vocabulary.n_words
    assert f"Grown from vocabulary {vocabulary.digest}" in (tmp_path / "second.vocabulary.txt").read_text("utf-8")


def test_a_place_that_is_not_there_is_said_before_any_work(stillroom: Callable, tmp_path: Path) -> None:
    said = stillroom("train-vocabulary", "synthetic:empty", "--out", str(tmp_path / "no" / "x.vocabulary"))
    assert said.code == 1
    assert "no such folder" in said.err
    said = stillroom("train-vocabulary", "synthetic:empty", "--out", str(tmp_path / "x"), "--grow", str(tmp_path / "y"))
    assert said.code == 1
    assert "no such file" in said.err
