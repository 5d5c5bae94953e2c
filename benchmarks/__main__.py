"""All benchmarks, one after the other, and one table of what they measured beside what was aimed at.

    python -m benchmarks [--quick] [--only graph swing ...] [--cores 2] [--limit 90] [--save FILE]

`make bench` runs this. A part is a file `bench_*.py` here, run in a process of its own; `test_speed.py` is the part
`speed`, run by pytest-benchmark. `--quick` makes every part small, and limits or leaves out what takes minutes. The
exit code is 1 if a part fails: when planners and peers disagree, or a climb is not found. A target that is not met is
shown, and no failure; whether it can be met depends on the machine. A part that takes longer than the limit is stopped
and has failed; what it measured until then is in the table, as it is if all are interrupted.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import platform
import signal
import subprocess
import sys
import tempfile
import threading
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from rich.console import Console

from benchmarks.rows import Row, markdown, table

HERE = Path(__file__).parent
# Arguments of the parts, in full and quick; a part that is not listed takes none.
ARGUMENTS = {
    "graph": ("--holds 1000 10000", "--walls W1 W2 --repeat 5 --peer-seconds 5"),
    "swing": ("", "--quick"),
    "task": ("", "--walls W1 W3 --repeat 1 --questions 20"),
    "team": ("--encodings literal", "--skip-peers --repeat 1 --questions 10"),
    "refine": ("--legs 20", "--legs 3"),
    "timing": ("", "--quick"),
    "solve": ("", "--quick"),
    "simulate": ("", "--quick"),
    "margins": ("", "--quick"),
    "equilibrium3": ("", "--sets 2000 --one-by-one 50 --peer-sets 100"),
}
LIMIT = 90.0  # [min] for a part; `simulate` takes the most, 40 on two cores that others use as well
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
INTERRUPTED = "interrupted"
SOFTWARE = ("climber-drake", "drake", "clingo", "numpy", "scipy", "ompl")


def parts() -> list[str]:
    """Names of all parts: those listed above first, then others found, the hot spots last."""
    found = [path.stem.removeprefix("bench_") for path in sorted(HERE.glob("bench_*.py"))]
    return [*ARGUMENTS, *(name for name in found if name not in ARGUMENTS), "speed"]


def command(part: str, quick: bool, results: Path) -> list[str]:
    """What to run for a part; pytest-benchmark leaves its numbers in `results`."""
    if part == "speed":
        options = ["--benchmark-min-rounds=3", "--benchmark-max-time=0.2"] if quick else []
        file = str(HERE / "test_speed.py")
        return [
            sys.executable,
            "-m",
            "pytest",
            file,
            "-q",
            "-p",
            "no:cacheprovider",
            f"--benchmark-json={results}",
            *options,
        ]
    arguments = ARGUMENTS.get(part, ("", ""))[quick].split()
    return [sys.executable, "-m", f"benchmarks.bench_{part}", *arguments]


def stream(arguments: list[str], seconds: float = 60.0 * LIMIT) -> tuple[list[Row], str]:
    """Runs a command and prints what it prints as it comes.

    Returns:
        The rows in what it printed, and why it failed, empty if it did not: its exit code, that it was stopped after
        so many seconds, or that somebody interrupted it.
    """
    rows = []
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(
        arguments,
        cwd=HERE.parent,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,  # so that processes of its own can be stopped along with it
    ) as process:
        assert process.stdout is not None
        late = threading.Event()
        watchdog = threading.Timer(seconds, lambda: (late.set(), stop(process)))
        watchdog.start()
        try:
            for line in process.stdout:
                row = Row.read(line)
                if row is None:
                    print(line, end="", flush=True)
                else:
                    rows.append(row)
        except KeyboardInterrupt:
            stop(process)
            return rows, INTERRUPTED
        finally:
            watchdog.cancel()
    if late.is_set():
        return rows, f"stopped after {seconds / 60.0:.3g} minutes"
    return rows, f"exit code {process.returncode}, see above" if process.returncode else ""


def stop(process: subprocess.Popen[str]) -> None:
    """Ends a process and those that it started."""
    if not hasattr(os, "killpg"):
        process.kill()
        return
    with contextlib.suppress(ProcessLookupError):  # it has just ended by itself
        os.killpg(process.pid, signal.SIGKILL)


def hot_spots(results: Path) -> list[Row]:
    """The rows of what pytest-benchmark measured."""
    if not results.exists() or not results.stat().st_size:
        return []
    rows = []
    for spot in json.loads(results.read_text())["benchmarks"]:
        stats = spot["stats"]
        what = spot["name"].removeprefix("test_").replace("_", " ")
        told = f"median of {stats['rounds']}, least {1e3 * stats['min']:.3g} ms"
        rows.append(Row(what, 1e3 * stats["median"], "ms", note=told))
    return rows


def machine(cores: int) -> str:
    """What the numbers were measured on."""
    versions = []
    for name in SOFTWARE:
        try:
            versions.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            versions.append(f"no {name}")
    threads = ", ".join(f"{name}={os.environ[name]}" for name in THREADS)
    return (
        f"{processor()}, {cores} of {os.cpu_count()} cores, {platform.system()}; "
        f"Python {platform.python_version()}, {', '.join(versions)}; {threads}"
    )


def processor() -> str:
    """The processor's name, as far as the system tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    return next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def load() -> str:
    """The load average of the last minute."""
    return f"{os.getloadavg()[0]:.1f}"


def limit_cores(most: int) -> int:
    """Keeps this process and its children on at most so many cores, where the system lets it; how many they have."""
    if not hasattr(os, "sched_setaffinity"):
        return os.cpu_count() or 1
    mine = sorted(os.sched_getaffinity(0))[:most]
    os.sched_setaffinity(0, mine)
    return len(mine)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="everything small, peers limited")
    parser.add_argument("--only", nargs="+", metavar="NAME", choices=parts(), help=f"of {', '.join(parts())}")
    parser.add_argument("--cores", type=int, default=2, help="cores to run on")
    parser.add_argument("--limit", type=float, default=LIMIT, metavar="MINUTES", help="stop a part after so long")
    parser.add_argument("--save", type=Path, metavar="FILE", help="write the table as Markdown, after every part")
    arguments = parser.parse_args()
    for name in THREADS:
        os.environ.setdefault(name, "1")
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # the table is printed then, too
    cores = limit_cores(arguments.cores)
    before = load()
    rows: list[Row] = []
    minutes: dict[str, float] = {}
    failed = ""
    title = "QUICK: small cases, peers limited" if arguments.quick else "Measured"
    told = ""
    with tempfile.TemporaryDirectory() as folder:
        results = Path(folder) / "speed.json"
        for part in arguments.only or parts():
            print(f"\n== {part} (load {load()})", flush=True)
            began = time.perf_counter()
            measured, failed_as = stream(command(part, arguments.quick, results), 60.0 * arguments.limit)
            minutes[part] = (time.perf_counter() - began) / 60.0
            if part == "speed":
                measured += hot_spots(results)
            if failed_as:
                failed = failed_as
                measured.append(Row(f"{part} FAILED", None, "", note=failed_as))
            rows += measured
            took = ", ".join(f"{name} {its:.1f}" for name, its in minutes.items())
            told = (
                f"{machine(cores)}; load {before} before, {load()} after; {sum(minutes.values()):.1f} minutes: {took}"
            )
            if arguments.save:
                arguments.save.write_text(f"{title}.\n\n{told}.\n\n{markdown(rows)}\n")
            if failed_as == INTERRUPTED:
                break
    console = Console(highlight=False)
    if not console.is_terminal:  # a log is as wide as it needs to be
        console = Console(highlight=False, width=200)
    console.print()
    console.print(table(rows, title))
    console.print(told, markup=False)
    sys.exit(bool(failed))


if __name__ == "__main__":
    main()
