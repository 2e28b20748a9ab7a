"""Digests of runs, files and figures: a refactoring changes none of them.

    python tests/benchmarks/digests.py [--only GLOB]                  prints `name digest`, sorted
    python tests/benchmarks/digests.py --against FOLDER [--only GLOB] prints what differs there
    python tests/benchmarks/digests.py --list                         prints the names of the cases

FOLDER is another checkout, for example an older one. This file is run on it too, on the same
machine and with the same libraries: digests differ between processors, so none are stored. The exit
code is 1 if any case differs or fails. Each checkout keeps its compiled code to itself.

Where possible it uses the command line and files, whose names are stable (`digest_files.py`); names
of the Python source, which may change, are in `digest_source.py`. `digest_cases.py`
lists all cases. Times, sizes of recordings, versions and the kind of machine are left out.
"""

from __future__ import annotations

import argparse
import fnmatch
import hashlib
import os
import subprocess
import sys
import time
import traceback
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # sums must not depend on the number of threads

import digest_source
import numpy as np
from digest_cases import cases


def digest(value: Any) -> str:
    made = hashlib.blake2b(digest_size=12)
    _feed(made, value)
    return made.hexdigest()


def _feed(made: Any, value: Any) -> None:
    """Raises TypeError for what has no bytes of its own, such as an object of the source."""
    if isinstance(value, np.ndarray) and value.dtype != object:
        if value.dtype.kind == "f":  # the sign of what is no number says nothing
            value = np.where(np.isnan(value), np.array(np.nan, value.dtype), value)
        made.update(f"{value.dtype.str} {value.shape} ".encode() + value.tobytes())
    elif isinstance(value, Mapping):
        for key in sorted(value):
            made.update(f"{key}: ".encode())
            _feed(made, value[key])
    elif isinstance(value, list | tuple | np.ndarray):
        made.update(f"{len(value)} ".encode())
        for one in value:
            _feed(made, one)
    elif value is None or isinstance(value, str | bytes | bool | int | float | np.generic):
        plain_value = value.item() if isinstance(value, np.generic) else value
        made.update(f"{plain_value!r} ".encode())
    else:
        raise TypeError(f"no digest of {type(value)}")


def digests(only: str, *, times: bool) -> dict[str, str]:
    """Of each part of the cases, as `case:part`; of a case that fails, its error."""
    found, made = {}, cases()
    for name in chosen(only):
        began = time.perf_counter()
        try:
            parts = made[name]()
            for part, value in parts.items():
                found[f"{name}:{part}".replace(" ", "-")] = digest(value)
        except Exception as error:
            traceback.print_exc()
            found[name] = f"FAILED {type(error).__name__}: {error}".replace("\n", " ")
        if times:
            sys.stderr.write(f"{time.perf_counter() - began:6.1f} s {name}\n")
    return found


def chosen(only: str) -> list[str]:
    return sorted(fnmatch.filter(cases(), only))


# Two checkouts


def elsewhere(root: Path, only: str, times: bool) -> dict[str, str]:
    """The digests of another checkout, made by this file in a process of its own."""
    words = [sys.executable, __file__, "--root", str(root), "--only", only, *["--times"] * times]
    made = subprocess.run(words, stdout=subprocess.PIPE, text=True, check=False)
    if not made.stdout:
        raise SystemExit(f"no digests of {root}: see above")
    return dict(line.split(" ", 1) for line in made.stdout.splitlines())


def differences(ours: Mapping[str, str], theirs: Mapping[str, str]) -> list[str]:
    """A line for each name under which the two do not say the same, or that failed in both."""
    names = sorted({*ours, *theirs})
    pairs = ((n, ours.get(n, "missing"), theirs.get(n, "missing")) for n in names)
    return [f"{n} {a} | {b}" for n, a, b in pairs if a != b or a.startswith("FAILED")]


def compared(other: Path, only: str, *, times: bool) -> int:
    with ThreadPoolExecutor() as threads:  # each waits for a process
        both = digest_source.root, other
        ours, theirs = threads.map(lambda root: elsewhere(root, only, times), both)
    found = differences(ours, theirs)
    say(found or [f"{len(ours)} digests are the same in both"])
    return 1 if found else 0


def say(lines: list[str]) -> None:
    sys.stdout.write("".join(f"{line}\n" for line in lines))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--against", type=Path, metavar="FOLDER", help="another checkout")
    parser.add_argument("--only", default="*", metavar="GLOB", help="of the names of cases")
    parser.add_argument("--list", action="store_true", help="print the names of the cases")
    parser.add_argument(
        "--root", type=Path, default=digest_source.root, metavar="FOLDER", help="the checkout"
    )
    parser.add_argument("--times", action="store_true", help="say how long each case takes")
    args = parser.parse_args()
    digest_source.root = args.root.resolve()
    if args.list:
        say(chosen(args.only))
        return 0
    if args.against is not None:
        return compared(args.against.resolve(), args.only, times=args.times)
    sys.path.insert(0, str(digest_source.root))
    digest_source.check_imported()
    found = digests(args.only, times=args.times)
    say([f"{name} {value}" for name, value in sorted(found.items())])
    return 1 if any(value.startswith("FAILED") for value in found.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
