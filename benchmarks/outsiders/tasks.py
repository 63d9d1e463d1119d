"""Evaluation of one stage or tip, for worker processes."""

from dataclasses import asdict

from benchmarks.outsiders.lateral import evaluate_stage
from benchmarks.outsiders.tips import evaluate_tip


def evaluate(task: tuple[str, str, int]) -> dict:
    """Evaluate one ``(stage or tip, simulator, seed)``."""
    kind, name, seed = task
    result = evaluate_stage(name, seed) if kind == "stage" else evaluate_tip(name, seed)
    return {"kind": kind, **asdict(result)}
