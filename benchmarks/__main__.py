"""Benchmarks: `python -m benchmarks COMMAND`; for people, and a JSON line each.

Times are the least of several runs, rivals in turns in one process; machines are noisy, so
compare ratios.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one core against one core

import typer

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, no_args_is_help=True)


@app.callback()
def main() -> None:
    """Benchmarks and large checks that are too slow for the tests."""


def _print(line: dict[str, Any]) -> None:
    print(json.dumps(line), flush=True)


@app.command()
def minimal(
    trees: Annotated[int, typer.Option(help="Random trees to verify besides.")] = 0,
    robots: Annotated[
        bool, typer.Option("--robots", help="Verify those of example-robot-data besides.")
    ] = False,
    cuts: Annotated[
        bool, typer.Option("--cuts", help="Verify force sensors at all of their joints besides.")
    ] = False,
    zeros: Annotated[
        bool, typer.Option("--zeros", help="Verify with parameters that are known to be zero.")
    ] = False,
) -> None:
    """Cost of a minimal set over joints; asked, witnesses: exit code 1 if they disagree."""
    from benchmarks.minimal import agreement, scaling
    from benchmarks.minimal import cuts as cut
    from benchmarks.minimal import robots as real

    _print(scaling())
    lines = [agreement(trees, zeros)] if trees else []
    lines += [real(zeros)] if robots else []
    lines += [cut()] if cuts else []
    for line in lines:
        _print(line)
    raise typer.Exit(int(any(line["disagreements"] for line in lines)))


@app.command()
def robots(
    seconds: Annotated[float, typer.Option(help="Of motion.")] = 6.0,
    only: Annotated[str, typer.Option(help="Only files whose paths hold this.")] = "",
) -> None:
    """`new` and a run of every robot of some packages; exit code 1 if one is refused or wrong."""
    from benchmarks.robot_files import runs

    line: dict[str, Any] = {}
    for line in runs(only, seconds):
        _print(line)
    raise typer.Exit(int(line.get("runs", 0) + line.get("no robot", 0) < line["files"]))


@app.command()
def regressor(rounds: Annotated[int, typer.Option(help="Turns that each rival has.")] = 60) -> None:
    """Rows, and sums of their products, against Pinocchio in a loop and lstsq."""
    from benchmarks.regressor import cases, compare

    for case in cases():
        for model in ("dynamic", "reaction"):
            _print(compare(case, model, rounds if case.tree.n < 10 else rounds // 4))


@app.command()
def sampling(
    robots: Annotated[list[str] | None, typer.Option("--robot", help="Default three.")] = None,
    seeds: Annotated[int, typer.Option(help="Experiments with each robot.")] = 200,
    first: Annotated[int, typer.Option(help="The first seed.")] = 0,
    seconds: Annotated[float, typer.Option(help="Of each recording.")] = 20.0,
) -> None:
    """Truth's rank among robots that `sample` draws, and bands of torque that they predict."""
    from benchmarks.sampling import ranks

    for robot in robots or ["puma", "ur5", "gantry_ppp_rrr"]:
        _print(ranks(robot, range(first, first + seeds), seconds))


@app.command()
def consistency(
    seeds: Annotated[int, typer.Option(help="Simulated recordings of each length.")] = 10,
    trees: Annotated[int, typer.Option(help="Random trees.")] = 100,
) -> None:
    """Consistent bodies: accuracy beside plain estimates."""
    from benchmarks import consistency as made

    _print(made.trees(trees, 1000))
    for speed in (0.3, 0.1):
        _print(made.poor(range(500, 500 + seeds), speed))
    for line in made.accuracy((60.0, 5.0), range(500, 500 + seeds)):
        _print(line)


@app.command()
def posterior(
    seeds: Annotated[int, typer.Option(help="Simulated robots of each kind.")] = 20,
    first: Annotated[int, typer.Option(help="The first seed.")] = 3900,
) -> None:
    """Fast motion by a slow one with the model file as prior: errors, coverage."""
    from benchmarks.posterior import slow_to_fast

    for friction in (0.0, 1.0, 3.0):
        _print(slow_to_fast(range(first, first + seeds), friction))


@app.command("answer")
def default_answer(
    rounds: Annotated[int, typer.Option(help="Turns that each rival has.")] = 2,
) -> None:
    """The default answer beside scripts on Pinocchio and iDynTree (extra `rivals`)."""
    from benchmarks.answer import answers

    for each in answers(rounds):
        _print(each)


@app.command()
def identify(
    rounds: Annotated[int, typer.Option(help="Turns that each rival has.")] = 8,
    gigabytes: Annotated[float, typer.Option(help="Size of a recording to identify.")] = 0.0,
) -> None:
    """The complete answer against Pinocchio in a loop and lstsq; threads; memory."""
    from benchmarks.identify import answer, memory, stored
    from benchmarks.regressor import cases

    known = {case.name: case for case in cases()}
    if gigabytes:  # first: what a process once held stays in its peak
        _print(stored(known["puma6"], gigabytes))
    _print(memory(known["puma6"]))
    for case in known.values():
        for model in ("dynamic", "reaction"):
            _print(answer(case, model, rounds))


@app.command()
def pictures() -> None:
    """Seconds and sizes of what a run is looked at with."""
    from benchmarks.pictures import pictures as measure

    _print(measure())


@app.command()
def simulate() -> None:
    """A recorded run against MuJoCo's bare steps."""
    from benchmarks.simulate import simulate as measure

    for step in (1e-4, 5e-4):
        _print(measure(step))


@app.command()
def equations(rounds: Annotated[int, typer.Option(help="Turns that each rival has.")] = 10) -> None:
    """Operations and cost of generated equations beside other generators'."""
    from benchmarks.equations import growth, puma, speed, trees

    _print(puma())
    _print(trees())
    _print(growth())
    _print(speed(rounds))


@app.command()
def mutation(
    mutants: Annotated[int, typer.Option(help="How many to draw.")] = 100,
    seed: Annotated[int, typer.Option(help="Of the draw.")] = 0,
    only: Annotated[str, typer.Option(help="Only mutants whose names match.")] = "testbed.*",
    jobs: Annotated[int, typer.Option(help="Processes at a time.")] = 1,
) -> None:
    """How many small wrong changes of the project the tests see; exit code 1 below the goal."""
    from benchmarks.mutation import GOAL
    from benchmarks.mutation import mutation as tried

    *_, found = _printed(tried(mutants, seed, only, jobs))
    raise typer.Exit(int(found["killed [%]"] < GOAL))


@app.command()
def nightly(
    only: Annotated[str, typer.Option(help="Only checks whose names hold this.")] = "",
    jobs: Annotated[int, typer.Option(help="Checks at a time.")] = 2,
    docs: Annotated[
        bool, typer.Option("--docs", help="Write docs/rivals.md, of 20 draws.")
    ] = False,
    python: Annotated[
        list[str] | None, typer.Option(help="Other tools: as `benchmarks rivals` takes it.")
    ] = None,
) -> None:
    """All that is too slow for the suite, as one table; exit code 1 if a check fails."""
    from benchmarks.nightly import nightly as outcomes

    failed, tools = False, [f"--python={each}" for each in python or ()]
    for each in outcomes(only, jobs, [*tools, *(["--docs"] if docs else ["--draws=2"])]):
        word = "passed" if each.passed else "FAILED"
        print(f"{each.name:<26} {word} {each.seconds:6.0f} s  {each.last[:160]}", flush=True)
        failed = failed or not each.passed
    raise typer.Exit(int(failed))


@app.command()
def hostile(
    inputs: Annotated[int, typer.Option(help="Of each kind.")] = 1000,
    kills: Annotated[int, typer.Option(help="Writers that are killed.")] = 60,
    seed: Annotated[int, typer.Option(help="Of all choices.")] = 0,
    only: Annotated[str, typer.Option(help="Only kinds whose names hold this.")] = "",
    seconds: Annotated[float, typer.Option(help="Of all inputs; 0 for no limit.")] = 0.0,
) -> None:
    """Hostile inputs through the real commands; exit code 1 if one is not treated well."""
    from benchmarks.hostile.inputs import KINDS
    from benchmarks.hostile.kills import kills as killed
    from benchmarks.hostile.program import Worker
    from benchmarks.hostile.program import hostile as tried

    kinds = [kind for kind in KINDS if only in kind]
    each = seconds / max(len(kinds), 1) or float("inf")
    with Worker() as worker:
        lines = list(_printed(tried(worker, kind, inputs, seed, each) for kind in kinds))
    lines += _printed(killed(count, seed) for count in (kills,) if count)
    raise typer.Exit(int(any(line["not treated well"] for line in lines)))


@app.command()
def faults(
    seconds: Annotated[float, typer.Option(help="Duration of the recordings.")] = 60.0,
    seeds: Annotated[int, typer.Option(help="Clean recordings of each of three robots.")] = 0,
) -> None:
    """Wrong data: errors of the estimates, and who says so; exit code 1 if harm goes unnoticed."""
    from benchmarks.faults import clean, results, total

    lines = []
    for line in results(seconds):
        lines.append(line)
        _print(line)
    found = total(lines)
    _print(found)
    for line in clean(seeds, min(seconds, 20.0)) if seeds else ():
        _print(line)
    raise typer.Exit(int(bool(found["silent"])))


@app.command()
def coverage(
    runs: Annotated[int, typer.Option(min=2, help="Recordings of each kind.")] = 200,
    first: Annotated[int, typer.Option(help="The first seed.")] = 5000,
    seconds: Annotated[float, typer.Option(help="Duration of the recordings.")] = 20.0,
    only: Annotated[str, typer.Option(help="Only studies whose words hold this.")] = "",
) -> None:
    """How often intervals of 95 % hold the truth: docs/uncertainty.md; exit code 1 if too few."""
    import testbed as tb
    from benchmarks.coverage import coverage as measured
    from benchmarks.coverage import studies

    asked = (study for study in studies(tb.Settings(), seconds) if only in study.words)
    lines = list(_printed(measured(study, first, runs) for study in asked))
    raise typer.Exit(int(not all(line["held"] for line in lines)))


@app.command()
def friction(
    seeds: Annotated[int, typer.Option(min=2, help="Recordings of each robot and loss.")] = 20,
    first: Annotated[int, typer.Option(help="The first seed.")] = 100,
    seconds: Annotated[float, typer.Option(help="Duration of the recordings.")] = 60.0,
    jobs: Annotated[int, typer.Option(help="Processes at a time.")] = 2,
) -> None:
    """Friction under load: a PUMA, gears that lose nothing to 20 %."""
    from benchmarks import friction

    for line in friction.study(seeds, first, seconds, jobs):
        _print(line)


@app.command()
def squatting(
    runs: Annotated[int, typer.Option(min=1, help="Recordings of 40 s.")] = 12,
    first: Annotated[int, typer.Option(help="The first seed.")] = 7200,
    noise: Annotated[float, typer.Option(help="Times that of the instruments.")] = 1.0,
    joint: Annotated[
        str, typer.Option(help="In the air, with a force sensor at it, e.g. left_hip_yaw_joint.")
    ] = "",
) -> None:
    """Errors in sigmas of a humanoid on plates with a measured pose, beside normal ones."""
    from benchmarks.squatting import scores

    for line in scores(first, runs, noise, joint):
        _print(line)


@app.command()
def twins(
    runs: Annotated[int, typer.Option(min=1, help="Recordings of each group.")] = 20,
    first: Annotated[int, typer.Option(help="The first seed.")] = 3900,
    only: Annotated[str, typer.Option(help="Only groups whose names hold this.")] = "",
) -> None:
    """Twins of real recordings: motors, payload, a joint that hardly moves, coarse poses."""
    from benchmarks.twins import scores

    for line in scores(first, runs, only):
        _print(line)


@app.command()
def accuracy(
    runs: Annotated[int, typer.Option(min=2, help="Recordings of each kind.")] = 40,
    first: Annotated[int, typer.Option(help="The first seed.")] = 9000,
    seconds: Annotated[float, typer.Option(help="Duration of the recordings.")] = 60.0,
    only: Annotated[str, typer.Option(help="Only lines whose words hold this.")] = "",
    motion: Annotated[str, typer.Option(help="Of the remedies' lines.")] = "chosen",
) -> None:
    """Errors over the Cramer-Rao bound, and of remedies over those without a fault."""
    from benchmarks.accuracy import REMEDIES, efficiency, remedies
    from benchmarks.random_recordings import MOTIONS

    if motion not in MOTIONS:
        raise typer.BadParameter(f"{motion} is none of {', '.join(MOTIONS)}")

    for robot in ("puma", "ur5"):
        if only in f"bound {robot}":
            _print(efficiency(robot, first, runs, seconds))
    asked = [fault for fault in REMEDIES if only in f"remedy {fault}"]
    for line in remedies(asked, motion, first, runs, seconds) if asked else ():
        _print(line)


@app.command()
def detection(
    runs: Annotated[int, typer.Option(min=1, help="Recordings of each kind.")] = 100,
    seed: Annotated[int, typer.Option(min=0, help="The first seed.")] = 7000,
    seconds: Annotated[float, typer.Option(help="Duration of the recordings.")] = 20.0,
    only: Annotated[str, typer.Option(help="Only trials whose words hold this.")] = "",
) -> None:
    """False alarms and power of the tests for the instrument's faults; exit code 1 below a goal."""
    from benchmarks.detection import detection as measured
    from benchmarks.detection import total, trials

    asked = [trial for trial in trials() if only in trial.words]
    lines = list(_printed(measured(trial, seed, runs, seconds) for trial in asked))
    if any(line["fault"] == "none" for line in lines):
        lines.append(total(lines))
        _print(lines[-1])
    raise typer.Exit(int(not all(line["held"] for line in lines)))


@app.command()
def mappings(
    robots: Annotated[str, typer.Option(help="Names, with commas; six unless said.")] = "",
    layouts: Annotated[str, typer.Option(help="Of files, with commas; all unless said.")] = "",
    count: Annotated[int, typer.Option(min=1, help="Recordings of each robot.")] = 40,
    seed: Annotated[int, typer.Option(min=0, help="Of robots, motions and what is planted.")] = 43,
    odd: Annotated[
        bool, typer.Option("--odd", help="Other robots, payloads, crosstalk, no motion; TX40.")
    ] = False,
) -> None:
    """Mappings by --guess, held against the truth; exit code 1 where the goal is missed."""
    from benchmarks import mappings as bench
    from benchmarks.foreign_recordings import LAYOUTS
    from benchmarks.inverse_recordings import ROBOTS

    if odd:
        from benchmarks.odd_mappings import scenarios, total

        said = total(list(_printed(scenarios(seed))))
        _print(said)
        raise typer.Exit(int(bool(said["not held"])))
    asked = robots.split(",") if robots else list(bench.SIX)
    kinds = layouts.split(",") if layouts else list(LAYOUTS)
    for name, known in [*((each, ROBOTS) for each in asked), *((each, LAYOUTS) for each in kinds)]:
        if name not in known:
            raise typer.BadParameter(f"{name} is none of {', '.join(known)}")
    found = bench.total(list(_printed(bench.study(asked, kinds, count, seed))))
    _print(found)
    raise typer.Exit(int(not bench.reached(found)))


def _printed(lines: Iterator[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Each line as it comes."""
    for line in lines:
        _print(line)
        yield line


@app.command()
def excite(
    seeds: Annotated[int, typer.Option(min=1, help="Designs of each robot.")] = 10,
    baseline: Annotated[int, typer.Option(min=1, help="Random motions to compare with.")] = 40,
    sets: Annotated[int, typer.Option(min=0, help="Random limits for each of four robots.")] = 50,
    model: Annotated[list[Path] | None, typer.Option(help="Another robot; again for more.")] = None,
    only: Annotated[str, typer.Option(help="Only robots whose names hold this.")] = "",
) -> None:
    """Designed motions: gain over random ones, random limits respected."""
    from benchmarks import excite as bench

    for case in bench.cases(model or []):
        if only in case.name:
            _print(bench.gain(case, seeds, baseline))
    for name in ("models/puma562.urdf", *(f"tests/golden/robots/{n}.urdf" for n in _SETS)):
        if sets:
            _print(bench.limit_sets(bench.ROOT / name, sets))


@app.command()
def campaign(
    moments: Annotated[int, typer.Option(min=0, help="Kills of each process.")] = 20,
    seconds: Annotated[float, typer.Option(help="Of real runs; 0 for none.")] = 60.0,
    seed: Annotated[int, typer.Option(help="Of the moments.")] = 0,
) -> None:
    """Campaigns: a run's cost, kills of workers and commands."""
    from benchmarks import campaign as bench

    if seconds:
        _print(bench.run_cost(seconds, 8))
    for who in ("worker", "command") if moments else ():
        line = bench.kills(who, moments, 150, seed)
        _print(line)
        if line["same_table"] != moments:
            raise typer.Exit(1)


@app.command()
def rivals(
    folder: Annotated[
        Path | None, typer.Argument(help="Of recordings and answers, resumed; default none kept.")
    ] = None,
    python: Annotated[
        list[str] | None, typer.Option(help="figaroh, idyntree, mujoco: NAME=INTERPRETER.")
    ] = None,
    draws: Annotated[int, typer.Option(min=1, help="Of every robot and noise.")] = 20,
    jobs: Annotated[int, typer.Option(help="Processes at a time.")] = 2,
    docs: Annotated[bool, typer.Option("--docs", help="Write docs/rivals.md.")] = False,
) -> None:
    """Other tools on the same recordings: docs/rivals.md; exit code 1 if testbed's are poor."""
    from tempfile import TemporaryDirectory

    from benchmarks.rivals.compare import GOAL
    from benchmarks.rivals.compare import rivals as compared

    pythons = dict(each.split("=", 1) for each in python or ())
    with TemporaryDirectory() as unkept:
        over = compared(folder or Path(unkept) / "set", pythons, draws, jobs, docs)
    raise typer.Exit(int(over > GOAL))


@app.command()
def rollout(
    python: Annotated[str, typer.Option(help="Interpreter that has mujoco.sysid.")],
    draws: Annotated[int, typer.Option(min=1, help="Of bodies, motions and noise.")] = 5,
    docs: Annotated[bool, typer.Option("--docs", help="Write docs/rivals.md.")] = False,
) -> None:
    """An unseen motion by written model files, beside mujoco.sysid as its documentation goes."""
    from benchmarks.rivals.rollout import rollouts

    print(rollouts(python, draws, docs))


bench = typer.Typer(no_args_is_help=True, help="Recordings for any tool, and a score of answers.")
app.add_typer(bench, name="bench")


@bench.command()
def make(
    folder: Annotated[Path, typer.Argument(help="A new folder.")],
    draws: Annotated[int, typer.Option(min=1, help="Of every robot and noise.")] = 1,
    first: Annotated[int, typer.Option(min=0, help="Seed of the first draw.")] = 0,
    every_fault: Annotated[bool, typer.Option("--every-fault", help="At every robot.")] = False,
) -> None:
    """Write recordings, and apart from them their truth: docs/rivals.md."""
    from benchmarks.bench import cases
    from benchmarks.bench import make as made

    _print(made(folder, list(cases(draws, every_fault)), first))


@bench.command()
def score(
    folder: Annotated[Path, typer.Argument(help="Of `make`.")],
    answers: Annotated[Path, typer.Argument(help="JSON of a tool's answers.")],
) -> None:
    """Errors, coverage and faults noticed of a tool's answers."""
    from benchmarks.bench import score as scored

    _print(scored(folder, json.loads(answers.read_text())))


_SETS = ("ur5", "gantry_ppp_rrr", "kuka_lwr4")


@app.command(name="all")
def everything() -> None:
    """All of them."""
    minimal()
    regressor()
    identify()
    equations()
    pictures()
    simulate()


if __name__ == "__main__":
    app()
