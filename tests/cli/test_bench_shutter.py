"""`stillroom bench shutter`: its rows, and what each of them models."""

import json
import re
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from stillroom.bench.shutter import (
    ALL,
    ALL_BUT_LOOK,
    DEPTH,
    HEADER,
    LIKELY,
    LOOK,
    NOTHING,
    PRIOR,
    SHUTTER,
    TURNS,
    shutter_parts,
)
from stillroom.cli.bench import app
from stillroom.dynamics.cluster_sieve import ClusterSieveConfig
from stillroom.presets.registry import configure

ROLLING = "synthetic:empty,path=rpy,frames=45,readout_ms=30"


@pytest.fixture(scope="module")
def figures(tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, dict[str, dict[str, Any]]]:
    file = tmp_path_factory.mktemp("shutter") / "figures.json"
    asked = ["shutter", ROLLING, "--method", "orb-slam2", "--json", str(file)]
    result = CliRunner().invoke(app, asked)
    assert result.exit_code == 0, result.output
    return result, {row["method"]: row for row in json.loads(file.read_text())["rows"]}


def test_one_command_prints_a_row_for_each_part(figures: tuple[Result, Any]) -> None:
    result, rows = figures
    assert list(rows) == [NOTHING, PRIOR, SHUTTER, DEPTH, LOOK, ALL_BUT_LOOK, ALL]
    for name, row in rows.items():
        line = next(line for line in result.stdout.splitlines() if re.match(rf" *{name}  ", line))
        cells = line.strip().removeprefix(name).split()
        assert len(cells) == len(HEADER) - 1 + 1  # the percent sign stands apart
        assert cells[:3] == [f"{row['ate_se3_m'][which]:.4f}" for which in ("median", "min", "max")]
        assert cells[3:6] == [f"{part['median']:.1f}" for part in row["jitter_fast_slow_mm"]]
        assert cells[6] == f"{row['rpe_translation_m_s']['median']:.4f}"
        assert cells[8:] == ["100.0", "%"]
    assert "readout of this camera: 30.0 ms" in result.stdout


def test_each_part_does_what_it_is_for(figures: tuple[Result, Any]) -> None:
    _, rows = figures
    ate_m = {name: row["ate_se3_m"]["median"] for name, row in rows.items()}
    jitter_mm = {name: row["jitter_fast_slow_mm"][0]["median"] for name, row in rows.items()}
    assert ate_m[SHUTTER] < 0.5 * ate_m[NOTHING]
    assert jitter_mm[PRIOR] < 0.3 * jitter_mm[NOTHING]
    assert ate_m[ALL] < ate_m[ALL_BUT_LOOK] < 0.5 * ate_m[NOTHING]
    assert jitter_mm[ALL] < 0.3 * jitter_mm[SHUTTER]


def test_the_configs_differ_in_what_they_say() -> None:
    own = configure("stillroom")
    parts = shutter_parts(own)
    assert list(parts) == [NOTHING, PRIOR, SHUTTER, DEPTH, TURNS, LIKELY, LOOK, ALL_BUT_LOOK, ALL]
    assert parts[ALL] == own
    for name, config in parts.items():
        assert (config.tracking.shutter == "rolling") == (name in (SHUTTER, ALL_BUT_LOOK, ALL))
        assert config.trajectory.enabled == (name in (PRIOR, ALL_BUT_LOOK, ALL))
        assert isinstance(config.dynamics, ClusterSieveConfig)
        sigmas = {config.tracking.depth.right_sigma, config.mapping.bundle.right_sigma, config.loops.bundle.right_sigma}
        assert sigmas == {0.5 if name in (DEPTH, ALL_BUT_LOOK, ALL) else 1.0}
        assert (config.dynamics.max_turn_rad_s < 1.0) == (name in (TURNS, ALL_BUT_LOOK, ALL))
        assert config.last_look.enabled == (name in (LOOK, ALL))
        assert config.dynamics.weighted == (name == LIKELY)


def test_a_methods_own_values_are_kept() -> None:
    parts = shutter_parts(configure("oc-slam", None, ("dynamics.max_turn_rad_s=2.5", "trajectory.lag=3")))
    assert parts[ALL].trajectory.lag == 3
    assert parts[ALL].dynamics.max_turn_rad_s == 2.5  # type: ignore[attr-defined]
    assert parts[NOTHING] == configure("oc-slam", None, ("trajectory.lag=3",))
    assert NOTHING in shutter_parts(configure("orb-slam2"))
