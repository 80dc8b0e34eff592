"""Run the benchmarks that `declared.py` lists, keep what they gave, and bring the pages' tables up to date.

    python benchmarks/run.py [NAME ...] [--quick] [--out FILE]    measure (all that this machine can, without names)
    python benchmarks/run.py --list                               what there is
    python benchmarks/run.py --write                              write the tables of README and docs anew
    python benchmarks/run.py --keep FILE ...                      take in records of a script's --record

Every benchmark runs in a process of its own, one after the other. After each the results so far are written to one JSON
file, `history/DATE_MACHINE_DEVICE.json` or FILE, so that a run that is stopped keeps what was finished. ``--quick``
tries the benchmarks with small sizes; without ``--out`` its file goes to `out/bench`, since such figures are not kept.

Exits with 1 if a bound is missed or a benchmark fails, one line each; with 2 where the request makes no sense.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

import tables
from bough.sim.base.console import shown, start_warp
from bough.sim.base.errors import InputError
from bough.sim.base.strict_yaml import nearest
from declared import BENCHMARKS, Benchmark, named
from history import FOLDER, Run, last, new_path, read, runs
from measuring import ROOT, commit, write_json

SCRATCH = ROOT / "out" / "bench"


def has_gpu() -> bool:
    """Return whether Warp finds a GPU."""
    import warp as wp

    start_warp()
    return bool(wp.get_cuda_device_count())


def chosen(names: Sequence[str]) -> list[Benchmark]:
    """Return the benchmarks of these names; without names, all that this machine can run.

    Raises:
        InputError: A name that is not declared, or one that wants a GPU where there is none.
    """
    gpu, every = has_gpu(), [b.name for b in BENCHMARKS]
    for name in names:
        if name not in every:
            raise InputError("benchmarks/run.py", "NAME", repr(name), nearest(name, every))
        if named(name).device == "gpu" and not gpu:
            raise InputError("benchmarks/run.py", name, "no GPU", "a machine with an NVIDIA GPU")
    return [named(n) for n in names] or [b for b in BENCHMARKS if gpu or b.device == "cpu"]


def run_one(benchmark: Benchmark, quick: bool, scratch: Path) -> Run | None:
    """Run a benchmark in a process of its own; None where it fails.

    What a script writes lies in ``scratch`` while it works, so that calibration goes on where it was stopped; it is
    moved aside when it is done, so that the next run begins anew.
    """
    work, record = scratch / benchmark.name, scratch / f"{benchmark.name}.json"
    record.unlink(missing_ok=True)
    arguments = [a.format(out=work) for a in (benchmark.quick if quick else benchmark.arguments)]
    script = Path(__file__).parent / f"{benchmark.script}.py"
    subprocess.run([sys.executable, str(script), *arguments, "--record", str(record)], check=False)
    if not record.exists():
        return None
    if work.exists():
        finished = scratch / f"{benchmark.name}-finished"
        shutil.rmtree(finished, ignore_errors=True)
        work.rename(finished)
    return read(record)


def scratch_folder(quick: bool) -> Path:
    """Return a folder for what scripts write: one a commit, a fresh one where the code differs from any."""
    head, dirty = commit()
    SCRATCH.mkdir(parents=True, exist_ok=True)
    if head is None or dirty:
        return Path(tempfile.mkdtemp(prefix="changed-", dir=SCRATCH))
    return SCRATCH / f"{head[:10]}{'-quick' if quick else ''}"


def joined(done: Sequence[Run]) -> Run:
    """Return the runs of one session as one; date, machine and versions are the first one's."""
    return done[0].model_copy(update={"results": {name: r for run in done for name, r in run.results.items()}})


def save(run: Run, path: Path) -> None:
    """Write a file of the history, whole or not at all; what a figure does not have is left out."""
    content = run.model_dump(mode="json")
    for result in content["results"].values():
        for kind in ("figures", "verdicts"):
            result[kind] = [{k: v for k, v in entry.items() if v not in (None, "")} for entry in result[kind]]
    write_json(path, content)


def file_for(run: Run, names: Iterable[str], quick: bool) -> Path:
    """Name the file of a run of these benchmarks: in the history, or, for a quick one, beside what scripts write."""
    device = "gpu" if any(named(n).device == "gpu" for n in names) else "cpu"
    return new_path(run.date, run.machine, device, SCRATCH if quick else FOLDER)


def measure(benchmarks: Sequence[Benchmark], quick: bool, out: Path | None) -> int:
    """Run benchmarks in turn and keep what is finished; return the exit code."""
    done: list[Run] = []
    complaints: list[str] = []
    scratch = scratch_folder(quick)
    for benchmark in benchmarks:
        print(f"\n=== {benchmark.name}: {benchmark.measures} About {benchmark.minutes:g} minutes.", flush=True)
        try:
            run = run_one(benchmark, quick, scratch)
        except KeyboardInterrupt:
            complaints.append(f"{benchmark.name}: stopped; what was finished is kept")
            break
        if run is None:
            complaints.append(f"{benchmark.name}: failed, nothing is kept of it")
            continue
        missed = [v.line() for v in run.results[benchmark.name].verdicts if not v.met]
        complaints += [f"{benchmark.name}: {' '.join(line.split())}" for line in missed]
        done.append(run)
        out = out or file_for(run, [b.name for b in benchmarks], quick)
        save(joined(done), out)
    print("\n".join(["", *complaints, *([f"wrote {shown(out)}"] if done and out else [])]))
    return 1 if complaints else 0


def keep(files: Sequence[Path]) -> int:
    """Take records that scripts wrote, here or on another machine, into the history.

    Raises:
        InputError: A file is no record, or of a benchmark that is not declared; then none is taken.
    """
    every, records = [b.name for b in BENCHMARKS], [read(file) for file in files]
    for file, run in zip(files, records, strict=True):
        for name in set(run.results) - set(every):
            raise InputError(file, "results", repr(name), nearest(name, every))
    for run in records:
        path = file_for(run, run.results, quick=False)
        save(run, path)
        print(f"wrote {shown(path)}")
    return 0


def show() -> int:
    """Print what is declared and when each was last run."""
    every = runs()
    for b in BENCHMARKS:
        found = last(b.name, every)
        when = f"last {found.run.date}" if found else "not run yet"
        print(f"{b.name} ({b.device}, about {b.minutes:g} min, {when}): {b.measures}")
        limits = "; ".join(x.text() for x in b.bounds) or f"no bound: {b.unbound}"
        print(f"    beside {b.peer or 'nothing'}; {limits}")
    return 0


def options() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="a benchmark of --list")
    parser.add_argument("--quick", action="store_true", help="small sizes, to try the benchmarks")
    parser.add_argument("--out", type=Path, help="the JSON file, instead of one in benchmarks/history")
    other = parser.add_mutually_exclusive_group()
    other.add_argument("--list", action="store_true", help="print what is declared")
    other.add_argument("--write", action="store_true", help="write the pages' tables anew")
    other.add_argument("--keep", type=Path, nargs="+", metavar="FILE", help="take records into the history")
    return parser.parse_args()


def main() -> int:
    """Do what is asked; return the exit code."""
    asked = options()
    try:
        if asked.list:
            return show()
        if asked.write:
            return tables.write()
        if asked.keep:
            return keep(asked.keep)
        if asked.out and (asked.out.is_dir() or not asked.out.absolute().parent.is_dir()):
            raise InputError("benchmarks/run.py", "--out", str(asked.out), "a file in a folder that exists")
        return measure(chosen(asked.names), asked.quick, asked.out)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
