"""Nothing that a robot or a listing asks for takes all time and memory: it is refused in time."""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.errors import ExpressionError
from testbed.symbolic.budget import MAX_TERMS, Budget
from testbed.symbolic.compare import compare_equations
from testbed.symbolic.equations import FORMS, Form, equations
from testbed.symbolic.expression import LARGEST_NUMBER, Nature, expression, number, symbol
from testbed.symbolic.kinds import KINDS
from testbed.symbolic.languages import write_equations
from testbed.symbolic.languages.paper import line
from testbed.symbolic.parse import read_listing
from testbed.symbolic.polynomial import LARGEST, Ring

SECONDS = 60
"""Of processor time, after which the system ends a command that would never end."""
MEGABYTES = 1000
"""Above what a process takes that has loaded the same libraries."""


def plus(terms: list[str]) -> str:
    return " + ".join(terms)


MANY = [f"{k}*q1^{k % 20 + 1}*q2^{k // 20 % 20 + 1}*q3^{k // 400 % 20 + 1}" for k in range(8000)]
"""Different terms."""

BOMBS = {
    "a product of numbers": "Q1 = " + "1*" * 2_000_000 + "1",
    "a product of names": "Q1 = " + "q1*" * 100_000 + "q1",
    "signs": "Q1 = " + "-" * 5_900_000 + "q1",
    "a chain of 20 000 definitions": "\n".join(
        ["a0 = q1", *(f"a{k + 1} = a{k} + q1*q2" for k in range(20_000)), "Q1 = a20000"]
    ),
    "definitions that grow": "\n".join(
        ["a0 = q1", *(f"a{k + 1} = a{k} + {MANY[k]}" for k in range(8000)), "Q1 = a8000"]
    ),
    "squares of sums": "\n".join(
        ["a0 = q1 + q2", *(f"a{k + 1} = a{k}*a{k} + q1" for k in range(39)), "Q1 = a39"]
    ),
    "squares of a name": "\n".join(
        ["a0 = q1", *(f"a{k + 1} = a{k}*a{k}" for k in range(39)), "Q1 = a39"]
    ),
    "squares of a number": "\n".join(
        ["a0 = 7", *(f"a{k + 1} = a{k}*a{k}" for k in range(39)), "Q1 = a39*q1"]
    ),
    "a long sum many times": f"X = {plus(MANY[:5000])}\nQ1 = {plus(['X*q1'] * 100_000)}",
    "waves": "Q1 = " + "*".join(f"(C1{'2' * k} + S2{'3' * k})" for k in range(30)),
    "a power of a sum": "Q1 = " + "*".join([f"({plus(['q1', 'q2', 'q3', 'qp1', 'qp2'])})"] * 50),
    "many terms": "Q1 = " + plus([f"{k}*q1*q2*C2*S3*qp1*qp2" for k in range(140_000)]),
    "many brackets": "Q1 = " + plus(["(" * 49 + "q1" + " + q2)*q3" * 49] * 10_000),
    "many terms of a short listing": "Q1 = " + plus([f"{k}*q1" for k in range(100_000)]),
    "an angle": "Q1 = C" + "1" * 4_000_000,
    "empty lines": "\n" * 5_900_000 + "Q1 = 0",
    "continued lines": "Q1 = 0\n" + " + 1\n" * 1_000_000,
    "many definitions": "Q1 = 1\n" + "\n".join(f"x{k} = 1" for k in range(400_000)),
    "zeros": "Q1 = " + plus(["0*1*1*1*1*1*1*1"] * 300_000),
}


SHORT = (
    "a chain of 20 000 definitions",
    "many terms of a short listing",
    "signs",
    "empty lines",
)
"""What is compared; all else is refused."""


@pytest.mark.slow
@pytest.mark.parametrize("name", BOMBS)
def test_a_listing_takes_no_memory_without_end(name: str, puma: tb.Tree) -> None:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    if name in SHORT:
        assert compare_equations(puma, BOMBS[name], zeros=True)["Q1"]
    else:
        with pytest.raises(ExpressionError) as caught:
            compare_equations(puma, BOMBS[name], zeros=True)
        assert len(str(caught.value)) < 400
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert grown < MEGABYTES * 1000


def chain(joints: int, axes: str, kind: str = "revolute") -> str:
    """A URDF chain with offsets in all directions."""
    rng = np.random.default_rng(0)
    text = '<robot name="chain"><link name="b0"/>'
    for k in range(1, joints + 1):
        axis = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}[axes[k % len(axes)]]
        x, y, z = rng.uniform(-0.3, 0.3, 3)
        text += (
            f'<link name="b{k}"><inertial><mass value="1"/><origin xyz="0.1 0.1 0.1"/>'
            '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="j{k}" type="{kind}"><parent link="b{k - 1}"/><child link="b{k}"/>'
            f'<origin xyz="{x} {y} {z}"/><axis xyz="{axis}"/>'
            '<limit lower="-3" upper="3" effort="9" velocity="9"/></joint>'
        )
    return text + "</robot>"


LIMITED = """
import resource, runpy, sys
import testbed.symbolic.equations, testbed.robot.formats.urdf
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + {megabytes}_000_000,) * 2)
resource.setrlimit(resource.RLIMIT_CPU, ({seconds}, {seconds}))
sys.argv[0] = "testbed"
runpy.run_module("testbed.cli", run_name="__main__", alter_sys=False)
"""


def limited(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """The command line under limits of memory and processor time."""
    code = LIMITED.format(megabytes=MEGABYTES, seconds=SECONDS)
    command = [sys.executable, "-c", code, *words]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is told by Linux only")
@pytest.mark.parametrize("form", ["full", "reduced"])
@pytest.mark.parametrize("joints", [12, 20])
def test_long_literal_equations_are_refused_with_two_ways_on(
    joints: int, form: str, tmp_path: Path
) -> None:
    (tmp_path / "chain.urdf").write_text(chain(joints, "xyz"))
    done = limited("equations", "chain.urdf", "--form", form, cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert "more than 150000 terms" in done.stderr
    assert "--form recursive" in done.stderr
    assert "--max-terms" in done.stderr
    assert done.stderr.count("\n") == 1
    recursive = limited("equations", "chain.urdf", "--form", "recursive", cwd=tmp_path)
    assert recursive.returncode == 0


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMS)
def test_the_limit_is_raised_by_an_option_and_changes_nothing_else(
    form: Form, puma: tb.Tree
) -> None:
    kinds = list(KINDS)
    whole = write_equations(equations(puma, kinds, form), "python")
    refused, enough = 1, MAX_TERMS
    while enough - refused > 1:
        middle = (refused + enough) // 2
        try:
            text = write_equations(equations(puma, kinds, form, max_terms=middle), "python")
        except ExpressionError:
            refused = middle
        else:
            assert text == whole
            enough = middle
    with pytest.raises(ExpressionError, match=f"more than {refused} terms") as caught:
        equations(puma, kinds, form, max_terms=refused)
    assert ("--form recursive" in str(caught.value)) == (form != "recursive")
    written = sum(
        len(value.terms)
        for each in equations(puma, kinds, form).equations
        for _, value in each.program.steps
    )
    assert enough >= written / 2


def test_a_listing_of_the_limits_length_is_read_and_a_longer_one_is_not(puma: tb.Tree) -> None:
    names = {"q1": symbol(Nature.POSITION, "q1"), "q2": symbol(Nature.POSITION, "q2", 1)}
    text = "Q1 = " + plus([f"{k + 1}*q1^{k % 5 + 1}*q2^{k // 5 + 1}" for k in range(50)])
    assert len(read_listing(text, names, 1000)["Q1"].terms) == 50
    with pytest.raises(ExpressionError, match="more than 40 terms"):
        read_listing(text, names, 40)
    with pytest.raises(ExpressionError, match="a listing of more than 400 characters"):
        read_listing(text, names, 10)
    own = write_equations(equations(puma), "paper")
    assert not any(compare_equations(puma, own).values())
    with pytest.raises(ExpressionError, match="more than 100 terms"):
        compare_equations(puma, own, max_terms=100)


@pytest.mark.parametrize(
    "text", ["1/1e-320", "1e300", "1e100*1e100", "(1e140 + q1)*1e140*(q1 + 1)"]
)
def test_numbers_that_are_too_large_are_refused(text: str) -> None:
    def multiplied_out() -> None:
        read = read_listing(f"Q1 = {text}", {"q1": symbol(Nature.POSITION, "q1")})
        Ring().expand(read["Q1"])

    with pytest.raises(ExpressionError, match="too large"):
        multiplied_out()


def test_numbers_up_to_the_largest_are_exact() -> None:
    x = symbol(Nature.POSITION, "x")
    for size in (LARGEST_NUMBER, -LARGEST_NUMBER, 1 / LARGEST_NUMBER):
        assert line(x * size) == f"{'-' * (size < 0)}{int(abs(size)) or abs(size)}*x"
        assert x * size - x * size == number(0)
    with pytest.raises(ExpressionError, match="too large"):
        x * (LARGEST_NUMBER * 1.01)
    with pytest.raises(ExpressionError, match="too large"):
        x * float("nan")


def test_the_names_of_brackets_do_not_grow_without_end() -> None:
    """Brackets in brackets: equal ones stay one object, others differ."""
    values = [symbol(Nature.POSITION, "q1") + 1, symbol(Nature.POSITION, "q2") + 1]
    for _ in range(60):
        values = [expression(value * value) + 1 for value in values]
        assert all(len(f.name) <= 200 for v in values for factors, _ in v.terms for f in factors)
        assert values[0] != values[1]
    again = symbol(Nature.POSITION, "q1") + 1
    for _ in range(60):
        again = expression(again * again) + 1
    assert again == values[0]


def test_a_budget_counts_products_for_less() -> None:
    budget = Budget(100)
    budget.write(50)
    budget.multiply(500)
    with pytest.raises(ExpressionError, match="more than 100 terms"):
        budget.multiply(1)


@pytest.mark.slow
def test_two_hundred_arms_on_one_bedplate(tmp_path: Path) -> None:
    """Long sums: their pairs of terms are not looked at one by one."""
    one = chain(1, "x").removesuffix("</robot>")
    joints = one.partition('<link name="b0"/>')[2]
    text = '<robot name="star"><link name="b0"/>'
    for k in range(200):
        text += joints.replace('"b1"', f'"b{k + 1}"').replace('"j1"', f'"j{k + 1}"')
    (tmp_path / "star.urdf").write_text(text + "</robot>")
    tree = tb.load_tree(tmp_path / "star.urdf")
    count = equations(tree, "base-wrench", "recursive").equations[0].program.count
    assert count.multiplications < 30 * tree.n


def test_a_product_has_as_many_factors_as_a_polynomial_has_degrees() -> None:
    known = {"q1": symbol(Nature.POSITION, "q1")}
    longest = "*".join(["q1", *["1"] * (LARGEST - 1)])
    assert read_listing(f"Q1 = {longest}", known)["Q1"] == known["q1"]
    with pytest.raises(ExpressionError, match=f"a product of more than {LARGEST} factors"):
        read_listing(f"Q1 = {longest}*q1", known)
