"""What a chart says of cells whose times and depths are known."""

import csv
import io
import json
import re

import numpy as np
import pytest

from palmar.eval.chart import CLOCKS, NUMBERS, Cell, by_contacts, by_fingers, chart_csv, dots, judge, lead, pareto
from palmar.eval.chart_page import build_page


def make_cell(solver, level, us, depth_mm, *, failed=0, quality="", in_use="", contacts=5, trace="ball grasp"):
    """A cell of 100 steps and 2 repeats: `us` in each step of the first, twice that in the second."""
    times = np.full((2, 100), float(us))
    times[1] *= 2
    numbers = {name: depth_mm for name in NUMBERS} | {"force_above_20hz_n": None}
    judged = {
        "numbers": numbers,
        "steps": 100,
        "failed": failed,
        "failures": {"wrong_side": failed, "kept_previous": 0, "deep": failed},
        "not_converged": 0,
    }
    clocks = {clock: times if clock in ("cpu_us", "wall_us") else times / 4 for clock in CLOCKS}
    return Cell(trace, level, level + 1, solver, quality, in_use, judged, clocks, np.full(100, contacts))


CELLS = [
    make_cell("progressive", 500, 20, 0.0),
    make_cell("progressive", 3000, 30, 0.0),
    make_cell("paper", 500, 10, 2.0, failed=7),
    make_cell("paper", 3000, 60, 0.05),
    make_cell("god_object", 500, 15, 0.01),
    make_cell("god_object", 3000, 120, 0.02),
]


def test_cost_is_the_least_of_the_repeats_and_the_tail_is_all_of_them():
    (dot,) = dots(CELLS[:1], "progressive")
    assert dot.cost_us == {"p50": 20, "p99": 20}
    assert dot.tail_us["p99"] == dot.tail_us["max"] == 40


def test_times_are_of_the_steps_in_which_the_first_solver_touches():
    first, other = make_cell("progressive", 500, 20, 0.0), make_cell("paper", 500, 10, 0.0)
    first.contacts[50:] = 0
    other.times_us["cpu_us"][:, 50:] = 1e6
    assert {dot.solver: dot.cost_us["p99"] for dot in dots([first, other], "progressive")} == {
        "progressive": 20,
        "paper": 10,
    }


def test_a_dot_holds_the_worst_trace_and_counts_the_failed_steps_of_all():
    cells = [make_cell("paper", 500, 10, 2.0, failed=7), make_cell("paper", 500, 10, 3.0, failed=2, trace="cup grasp")]
    (dot,) = dots(cells, "progressive")
    assert (dot.numbers["hover_mm"], dot.failed, dot.failures["deep"], dot.traces, dot.steps) == (3.0, 9, 9, 2, 200)
    assert dot.numbers["force_above_20hz_n"] is None


def test_the_pareto_line_leaves_out_what_failed_and_what_another_dot_beats():
    found = dots(CELLS, "progressive")
    line = [(dot.solver, dot.level) for dot in pareto(found, "penetration_spheres_mm")]
    assert line == [("god_object", 500), ("progressive", 500)]
    assert pareto(found, "force_above_20hz_n") == []


def test_the_sentence_says_where_the_product_leads_and_where_not():
    said = lead(dots(CELLS, "progressive"), "progressive")
    assert said.startswith(
        "progressive is never inside the spheres and fails none of 200 steps in 2 replays, at 20 to 30"
    )
    assert "god_object holds 0.1 mm, 0.02 mm deep, at 1.7 times its time" in said  # sqrt(0.75 * 4)
    assert "paper fails 7 steps, 2 mm deep" in said
    # paper 3000 and god_object 3000 are slower and deeper; none is faster and as exact.
    assert said.endswith("of the 4 dots of other solvers 2 are both slower and no shallower, 0 the reverse.")
    rounded = lead(dots([make_cell("progressive", 500, 20, 9e-15)], "progressive"), "progressive")
    assert rounded.startswith("progressive is never inside the spheres")
    better = lead(dots([*CELLS, make_cell("penalty", 500, 5, 0.0)], "progressive"), "progressive")
    assert "penalty holds 0.1 mm, 0 mm deep, at 4.0 times as fast" in better and better.endswith("1 the reverse.")


def test_every_dot_is_a_row_of_the_table_with_what_was_not_measured_empty():
    rows = list(csv.DictReader(io.StringIO(chart_csv(dots(CELLS, "progressive")))))
    assert len(rows) == 6 and rows[2]["failed_steps"] == "7" and rows[0]["force_above_20hz_n"] == ""
    assert rows[0]["penetration_spheres_mm"] == "0" and rows[0]["step_tail_max_us"] == "40"


def test_cost_against_contacts_and_fingers_leaves_no_step_to_another_bin():
    few, many = make_cell("paper", 500, 10, 0.0, contacts=3), make_cell("paper", 500, 40, 0.0, contacts=90, trace="b")
    rows = by_contacts([few, many])["paper"]
    assert [(row["steps"], row["p50"]) for row in rows] == [(100, 10), (100, 40)]
    assert rows[0]["contacts"] <= 4 and 60 <= rows[1]["contacts"] <= 130
    (row,) = by_fingers([few, make_cell("paper", 500, 20, 0.0, in_use="one finger")])
    assert (row["detection_us"], row["response_us"], row["total_us"]) == (5, 10, 20)


def test_the_page_holds_all_numbers_and_asks_the_network_for_nothing():
    found = dots(CELLS, "progressive")
    told = {"contacts": by_contacts(CELLS), "fingers": [], "product": "progressive", "note": "", "about": {"a": "<b>"}}
    page = build_page(found, sentence="all </script> well", **told)
    content = json.loads(re.search(r'id="content">(.*?)</script>', page, re.S)[1].replace("<\\/", "</"))
    assert [dot["failed"] for dot in content["dots"]] == [0, 0, 7, 0, 0, 0]
    assert [panel["number"] for panel in content["panels"]] == [
        "penetration_spheres_mm",
        "penetration_mesh_mm",
        "hover_mm",
    ]
    assert not re.search(r'(?:src|href)="(?!data:)|@import|fetch\(', page) and "&lt;b&gt;" in page
    assert "all &lt;/script&gt; well".capitalize() in page


def test_a_step_fails_by_depth_by_its_side_and_by_its_status(make_pack, make_run):
    pack = make_pack([[0, 0, 0, 0.02]])
    position = np.tile([0.0, 0.0, 1.0], (4, 1))
    # A palm sphere of 10 mm, 22 mm from the middle of a sphere of 20 mm: 8 mm inside it.
    position[1] = [0.022 + 0.02, 0.0, 0.0]
    run = make_run(4, palm_position_m=position, status=np.array([0, 0, 8, 2], dtype=np.uint32))
    judged = judge(run, pack, "thing")
    assert judged["failures"]["deep"] == 1 and judged["failures"]["kept_previous"] == 1
    assert judged["failed"] == 2 and judged["not_converged"] == 1
    assert judged["numbers"]["penetration_spheres_mm"] == pytest.approx(8.0, abs=1e-6)
