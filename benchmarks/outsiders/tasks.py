"""One stage or tip, judged in a process of its own."""

from dataclasses import asdict

from benchmarks.outsiders import lateral, tips


def judged(task: tuple[str, str, int]) -> dict:
    """Judge one ``(stage or tip, simulator, seed)``."""
    kind, name, seed = task
    found = (lateral if kind == "stage" else tips).judge(name, seed)
    return {"kind": kind, **asdict(found)}
