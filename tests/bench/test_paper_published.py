"""The printed numbers against the text of the papers, and whether they can be meant."""

import re

import pytest

from stillroom.bench.paper.published import PAPERS, Paper, paper
from stillroom.errors import ConfigError
from stillroom.presets.registry import all_methods

OC_TABLE_1 = """\
walking_static 0.325 0.284 0.213 0.007 0.006 0.006 97.8 97.8 97,1
walking_xyz 0.756 0.655 0.653 0.129 0.119 0.118 84.1 81.7 81.9
walking_half 0.426 0.433 0.414 0.083 0.085 0.080 80.4 80.3 80.6
sitting_static 0.008 0.008 0.007 0.008 0.008 0.007 -1.1 -3.7 2.6
"""
"""As printed: ORB-SLAM2's RMSE, mean and "Media", those of "Proposed", and the improvements; 97,1 has a comma."""

PSPNET_TABLE_1 = """\
s_static 0.0065 0.0052 - 0.010 0.012
w_halfsphere 0.0303 0.0473 0.0636 0.029 0.022
w_rpy 0.0442 0.2959 - 0.027 0.025
w_static 0.0081 0.0075 - 0.007 0.008
w_xyz 0.0247 0.0421 0.0336 0.018 0.016
"""
PSPNET_SYSTEMS = ("DS-SLAM", "Detect-SLAM", "L.Zhang et al", "SOF-SLAM", "PSPNet-SLAM")

PSPNET_TABLE_2 = """\
s_static 175.42 143.11
w_halfsphere 342.47 247.52
w_rpy 229.81 198.69
w_static 237.24 158.52
w_xyz 353.95 263.78
"""
LONG = {"walking_half": "walking_halfsphere"}
OC, PSPNET = paper("oc-slam"), paper("pspnet-slam")


def rows(text: str) -> dict[str, list[float | None]]:
    found = {}
    for line in text.splitlines():
        name, *cells = line.split()
        name = re.sub("^s_", "sitting_", re.sub("^w_", "walking_", LONG.get(name, name)))
        found[name] = [None if cell == "-" else float(cell.replace(",", ".")) for cell in cells]
    return found


def test_oc_slams_table_1_is_as_printed() -> None:
    printed = rows(OC_TABLE_1)
    assert OC.sequences == tuple(printed)
    for sequence, cells in printed.items():
        assert OC.printed_m("orb-slam2", sequence) == tuple(cells[:3])
        for system in OC.proposed:
            assert OC.printed_m(system, sequence) == tuple(cells[3:6])
            assert OC.printed_gains(system, sequence) == tuple(cells[6:])


def test_pspnet_slams_tables_are_as_printed() -> None:
    printed = rows(PSPNET_TABLE_1)
    assert PSPNET.sequences == tuple(printed)
    assert set(PSPNET.errors_m) == set(PSPNET_SYSTEMS)
    for sequence, cells in printed.items():
        for system, cell in zip(PSPNET_SYSTEMS, cells, strict=True):
            assert PSPNET.errors_m[system].get(sequence) == (None if cell is None else (cell,))
    assert PSPNET.geometry_ms == {name: tuple(cells) for name, cells in rows(PSPNET_TABLE_2).items()}
    assert PSPNET.printed_m("ds-slam", "walking_rpy") == (0.0442,)
    assert PSPNET.printed_m("orb-slam2", "walking_rpy") is None
    assert PSPNET.printed_m("ds-slam", None) is None


def test_the_times_are_those_of_the_text() -> None:
    for one in (OC, PSPNET):
        assert {time.system: time.ms for time in one.times} == {"OC-SLAM": 97.0, "DynaSLAM": 195.0}


def test_what_cannot_be_meant_is_marked_and_nothing_else_is() -> None:
    """No RMSE lies below the mean, and gains follow from the errors as far as these are rounded."""
    impossible = set()
    for system, cells in OC.errors_m.items():
        for sequence, (rmse, mean, _) in cells.items():
            if rmse < mean:
                impossible.add((system, sequence))
    for sequence, gains in OC.gains_percent["OC-SLAM"].items():
        base, ours = OC.errors_m["ORB-SLAM2"][sequence], OC.errors_m["OC-SLAM"][sequence]
        for theirs, own, gain in zip(base, ours, gains, strict=True):
            least = (1 - (own + 0.0005) / (theirs - 0.0005)) * 100 - 0.05
            most = (1 - (own - 0.0005) / (theirs + 0.0005)) * 100 + 0.05
            if not least <= gain <= most:
                impossible.add(("OC-SLAM", sequence))
    assert impossible == {(slip.system, slip.sequence) for slip in OC.misprints}
    assert [(slip.system, slip.sequence, slip.printed) for slip in PSPNET.misprints] == [
        ("DS-SLAM", "walking_rpy", "0.0442")
    ]


@pytest.mark.parametrize("name", PAPERS)
def test_every_system_is_a_preset(name: str) -> None:
    one: Paper = paper(name)
    assert set(one.systems) <= set(all_methods())
    assert set(one.proposed) <= set(one.systems)
    assert one.systems[0] == one.baseline == "orb-slam2"
    assert set(one.names.values()) == set(one.errors_m)


def test_another_paper_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"'orb-slam': no such paper; there are oc-slam and pspnet-slam"):
        paper("orb-slam")
