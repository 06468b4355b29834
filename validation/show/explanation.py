"""The table of an explanation, made from its ``explain.json``."""

from collections.abc import Mapping
from typing import Any

from validation.table import Table


def explanation_table(found: Mapping[str, Any]) -> Table:
    """Every change of a trial, what it makes of the verdict, and of the metrics that failed before or after.

    Args:
        found: contents of ``explain.json``.
    """
    before = found["trial"]
    rows = [(", ".join(item["layers"]), item["change"], *_end(item), _metrics(before, item)) for item in found["repeats"]]
    return Table(f"{found['title']}: one layer changed at a time", ("layer", "change", "verdict", "tightest", "metrics"), rows)

def _end(item):
    if "metrics" not in item:
        return "refused", item["cause"][:80]
    used=[m["used"] for m in item["metrics"].values() if m["used"] is not None]
    return ("pass" if item["passed"] else "FAIL" if item["outcome"]=="completed" else item["outcome"]), (f"{max(used):.2f} {sum(max(u-1,0) for u in used):.2f}" if used else f"{item['left']:.2f}")

def _metrics(before, item):
    if "metrics" not in item: return ""
    return "; ".join(f"{k} {before['metrics'][k]['text']} -> {m['text']}" for k,m in item["metrics"].items() if k in before["metrics"] and ((m["used"] or 0)>1 or (before["metrics"][k]["used"] or 0)>1))
