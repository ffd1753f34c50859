"""A scoreboard of following targets: runs its cases on a package, and compares two runs.

    python tools/following_scoreboard.py run NAME [--families F,G] [--seed N] [--count N] [--as BASE]
    python tools/following_scoreboard.py compare NAME [BASE] [-v]
    python tools/following_scoreboard.py freeze NAME [--noise TEXT]

A run writes `out/scoreboard/NAME.json` after each case, and goes on there where it was interrupted. The
seed is drawn anew and printed, unless it is given. `--as BASE` takes seed, number of cases and targets from
another run: a name, or a file such as `tools/following_scoreboard_base.json`, the figures of commit 2984f32e,
which are also what `compare` compares with. So `run mine --as tools/following_scoreboard_base.json` and
`compare mine` tell what a change did. Figures of seeds that nobody chose by need both packages:

    git worktree add ../before 2984f32e
    PYTHONPATH=../before python tools/following_scoreboard.py run before --families random,edge
    PYTHONPATH=. python tools/following_scoreboard.py run after --as before --families random,edge
    python tools/following_scoreboard.py compare after before -v

The package is the one that Python imports; its scenes and meshes are used. What a case tells:

- `miss`: weighted distance from the targets at the end, along a path the mean [m]; `worst`: the largest.
- `steps`: until no drive moves by more than 1e-6 of its scale; of jumps the sum of steps until balance.
- `restless`: whether a drive still moves after all steps that the robot is given.
- `home_miss`, `home_steps`: the same on the way home.
- `move`: largest move of a drive in a step of a path, as a share of its scale.
- `unbalanced`: jumps that did not end in balance.
- `status`, `statuses`: that of the last step, and how many steps ended with each.
- `ms`, `p99_ms`, `unit_ms`: processor time of a step, median and 99th percentile, and of a factorization of a
  fixed matrix by SuperLU right after them: the machine's speed at that time. `ratio`: a step of a circle in
  SuperLU factorizations of its own matrix, which alternate with the steps.

A case is worse where a miss grows by more than 1 % and 0.1 mm, or 0.001 mm along paths, and where more jumps
end out of balance. One or two such cases prove nothing: where a robot buckles or snaps, a change of the last
digits leads elsewhere. The base file, which `freeze` writes, tells how many do where only round-off differs.
Misses, steps and statuses of a package are the same in each run; beside other programs, times differ by up
to a fifth. The robots of `random` are those of `compare_inverse.py` with the same seed, which tells how many
rest away from the nearest place.
"""

from __future__ import annotations

import argparse
import json
import os
import secrets
import signal
import statistics
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

BASE = Path(__file__).with_name("following_scoreboard_base.json")
OUTPUT = Path("out") / "scoreboard"
SECONDS = 100
"""Processor time after which a case is stopped [s]; by default."""
WORSE, HARDLY, HARDLY_ALONG_PATHS, AT_HOME = 1.01, 1.0e-4, 1.0e-6, 1.0e-4
"""Ratio of misses, and their differences that count [m]; how near counts as at home [m]."""
FAILING, NOT_CONVERGED = ("inverted", "refused", "unsolved", "diverged"), "not_converged"


def read(name: str) -> dict:
    """A run, by its name or its file: ``seed``, ``count``, ``commit``, ``cases`` by name."""
    path = Path(name) if name.endswith(".json") else OUTPUT / f"{name}.json"
    return json.loads(path.read_text())


def write(path: Path, run: dict) -> None:
    """Writes a run as a whole or not at all, a case on each line."""
    head = {key: value for key, value in run.items() if key != "cases"}
    lines = [f"{json.dumps(name)}:{json.dumps(case, separators=(',', ':'))}"
             for name, case in run["cases"].items()]  # fmt: skip
    text = json.dumps(head, ensure_ascii=False)[:-1] + ', "cases": {\n' + ",\n".join(lines) + "\n}}\n"
    path.parent.mkdir(parents=True, exist_ok=True)
    new = path.with_suffix(".new")
    new.write_text(text)
    os.replace(new, path)


def rounded(value, digits: int = 5):
    """Figures with five digits, except targets, which are exact; what is False is left out."""
    if isinstance(value, dict):
        return {key: one if key == "targets" else rounded(one, digits) for key, one in value.items()
                if one is not False}  # fmt: skip
    return float(f"{value:.{digits}g}") if isinstance(value, float) else value


# --- running -------------------------------------------------------------------------------------


def _begin(given: argparse.Namespace) -> dict:
    """The run as it was interrupted, or a new one."""
    path = OUTPUT / f"{given.name}.json"
    old = read(given.like) if given.like else {}
    run = read(given.name) if path.exists() else {
        "seed": given.seed if given.seed is not None else old.get("seed", secrets.randbelow(10**6)),
        "count": given.count if given.count is not None else old.get("count"),
        "commit": _commit(), "cases": {},
    }  # fmt: skip
    run["known"] = {name: case["targets"] for name, case in old.get("cases", {}).items()
                    if "targets" in case}  # fmt: skip
    return run


def _commit() -> str:
    import softrobot_twin

    root = Path(softrobot_twin.__file__).parents[1]
    told = subprocess.run(["git", "-C", str(root), "describe", "--always", "--dirty"],
                          capture_output=True, text=True)  # fmt: skip
    return told.stdout.strip() or "unknown"


def _interrupt(*_) -> None:
    raise TimeoutError("more processor time than a case is given")


def run_cases(given: argparse.Namespace) -> None:
    """Runs the cases of some families that were not run yet."""
    # Reading and comparing runs needs no package.
    import following_cases

    run, path = _begin(given), OUTPUT / f"{given.name}.json"
    known, families = run.pop("known"), following_cases.FAMILIES
    if given.families:
        families = tuple(given.families.split(","))
        if unknown := set(families) - set(following_cases.FAMILIES):
            sys.exit(f"no family {', '.join(unknown)}; families: {', '.join(following_cases.FAMILIES)}")
    print(f"{given.name}: seed {run['seed']}, commit {run['commit']}", flush=True)
    signal.signal(signal.SIGPROF, _interrupt)
    times = Counter()
    for case in following_cases.all_cases(run["seed"], run["count"], known):
        if case.family not in families or case.name in run["cases"]:
            continue
        begin = time.process_time()
        signal.setitimer(signal.ITIMER_PROF, given.seconds)
        try:
            found = case.measure()
        except Exception as error:
            found = {"error": f"{type(error).__name__}: {error}"}
            following_cases.forget_robots()
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
        times[case.family] += time.process_time() - begin
        run["cases"][case.name] = rounded(found)
        write(path, run)
        if given.verbose or "error" in found:
            told = {key: value for key, value in rounded(found, 4).items() if key != "targets"}
            print(case.name, told, flush=True)
    print("processor time:", ", ".join(f"{family} {seconds:.0f} s" for family, seconds in times.items()))


# --- comparing -----------------------------------------------------------------------------------


def judge(name: str, new: dict, base: dict) -> str:
    """``worse``, ``better``, ``equal`` or ``error``."""
    if "error" in new or "error" in base:
        return "error"
    hardly = HARDLY_ALONG_PATHS if "worst" in base else HARDLY
    for key in ("miss", "worst", "unbalanced"):
        least = 0 if key == "unbalanced" else hardly
        before, after = base.get(key, 0.0), new.get(key, 0.0)
        if after > WORSE * before + least:
            return "worse"
        if before > WORSE * after + least:
            return "better"
    return "equal"


def _sum(cases: list[dict], key: str) -> float:
    return sum(case.get(key, 0) for case in cases)


def _statuses(cases: list[dict], *words: str) -> int:
    return sum(case.get("statuses", {}).get(word, 0) for case in cases for word in words)


def _median(cases: list[dict], key: str) -> float:
    found = [case[key] for case in cases if key in case]
    return statistics.median(found) if found else float("nan")


def _slower(cases: list[tuple[dict, dict]], key: str) -> str:
    """A time in that of the base, each in units of the machine at that time: the median of the cases."""
    ratios = [new[key] / new["unit_ms"] / (base[key] / base["unit_ms"])
              for new, base in cases if key in new]  # fmt: skip
    return f"{statistics.median(ratios):.2f}" if ratios else "nan"


FIGURES = {
    "restless": lambda cases: f"{_sum(cases, 'restless'):d}",
    "steps": lambda cases: f"{_sum(cases, 'steps'):d}",
    "ms": lambda cases: f"{_median(cases, 'ms'):.2f}",
    "p99, ms": lambda cases: f"{_median(cases, 'p99_ms'):.1f}",
    "ratio": lambda cases: f"{_median(cases, 'ratio'):.3f}",
    "mean miss, mm": lambda cases: f"{1e3 * _sum(cases, 'miss') / max(1, len(cases)):.3f}",
    "failing": lambda cases: f"{_statuses(cases, *FAILING)}",
    "not converged": lambda cases: f"{_statuses(cases, NOT_CONVERGED)}",
    "ok at the end": lambda cases: f"{sum(case.get('status') == 'ok' for case in cases)}",
    "unbalanced": lambda cases: f"{_sum(cases, 'unbalanced'):d}",
    "home missed": lambda cases: f"{sum(case.get('home_miss', 0.0) > AT_HOME for case in cases)}",
    "home steps": lambda cases: f"{_sum(cases, 'home_steps'):d}",
}
"""What is told of a family, by a name."""


def summary(names: list[str], new: dict, base: dict) -> str:
    """The figures of some cases, in a line: those of the base, an arrow and the new ones."""
    judged = Counter(judge(name, new[name], base[name]) for name in names)
    good = [name for name in names if judge(name, new[name], base[name]) != "error"]
    words = [f"{len(names)} cases: worse {judged['worse']}, better {judged['better']}, "
             f"equal {judged['equal']}, errors {judged['error']}"]  # fmt: skip
    for word, key in (("time of a step", "ms"), ("p99", "p99_ms")):
        words.append(f"{word} × {_slower([(new[name], base[name]) for name in good], key)}")
    for word, figure in FIGURES.items():
        before, after = (figure([run[name] for name in good]) for run in (base, new))
        if {before, after} & {"nan"} or {before, after} == {"0"}:
            continue
        words.append(f"{word} {before} → {after}" if before != after else f"{word} {before}")
    return "; ".join(word for word in words if not word.endswith("nan"))


def compare_runs(given: argparse.Namespace) -> None:
    """Prints a run against another one, by family and as a whole, and single cases that differ."""
    run, other = read(given.name), read(given.base)
    new, base = run["cases"], other["cases"]
    if run["seed"] != other["seed"]:
        print(f"seeds differ ({run['seed']}, {other['seed']}): cases of the same name are others")
    families: dict[str, list[str]] = {}
    for name in (name for name in new if name in base):
        families.setdefault(name.split("/")[0], []).append(name)
    for family, names in families.items():
        print(f"{family}: {summary(names, new, base)}")
    print(f"all: {summary([name for names in families.values() for name in names], new, base)}")
    if "noise" in other:
        print(f"noise, where only round-off differs: {other['noise']}")
    if given.verbose:
        for name in (name for names in families.values() for name in names):
            _print_difference(name, new[name], base[name])


def freeze(given: argparse.Namespace) -> None:
    """Makes a run the base, with those statuses only that are compared."""
    run = read(given.name)
    for case in run["cases"].values():
        told = {word: count for word, count in case.pop("statuses", {}).items()
                if word in (*FAILING, NOT_CONVERGED)}  # fmt: skip
        case |= {"statuses": told} if told else {}
    write(BASE, {**run, **({"noise": given.noise} if given.noise else {})})


def _print_difference(name: str, new: dict, base: dict) -> None:
    judged = judge(name, new, base)
    keys = ("miss", "worst", "home_miss", "restless", "steps", "unbalanced", "status", "error")
    flips = [case.get("restless", False) or case.get("home_miss", 0.0) > AT_HOME for case in (new, base)]
    if judged != "equal" or flips[0] != flips[1]:
        told = [f"{key} {base.get(key)} → {new.get(key)}" for key in keys if key in new or key in base]
        print(f"  {name} {judged}: {', '.join(told)}")


def main() -> None:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    commands = parser.add_subparsers(required=True)
    runs = commands.add_parser("run")
    runs.add_argument("name", help="of the run, and of its file")
    runs.add_argument("--families", help="some, with commas between")
    runs.add_argument("--seed", type=int)
    runs.add_argument("--count", type=int, help="cases of each drawn family")
    runs.add_argument("--as", dest="like", help="seed, count and targets of another run")
    runs.add_argument("--seconds", type=int, default=SECONDS, help="processor time of a case at most")
    runs.set_defaults(do=run_cases)
    compares = commands.add_parser("compare")
    compares.add_argument("name")
    compares.add_argument("base", nargs="?", default=str(BASE))
    compares.set_defaults(do=compare_runs)
    freezes = commands.add_parser("freeze")
    freezes.add_argument("name")
    freezes.add_argument("--noise", help="what is told of round-off")
    freezes.set_defaults(do=freeze)
    for each in (runs, compares):
        each.add_argument("-v", "--verbose", action="store_true", help="tells single cases, too")
    given = parser.parse_args()
    given.do(given)


if __name__ == "__main__":
    main()
