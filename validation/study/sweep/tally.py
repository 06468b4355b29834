"""A sweep in one sentence: how many runs ended how, and whether that is a pass."""

from __future__ import annotations

from dataclasses import dataclass

from validation.study.sweep.table import BROKEN, LOST, STATES, State, SweepTable


@dataclass(frozen=True)
class SweepVerdict:
    """What is said of a sweep as a whole.

    Attributes:
        css: ``pass``, ``fail`` or ``open``.
        headline: a few words.
        sentence: with the counts.
    """

    css: str
    headline: str
    sentence: str


def judge_sweep(sweep: SweepTable) -> SweepVerdict:
    """Say whether a sweep passes: every run that walked met every tolerance, and every run has an answer."""
    counts = sweep.counts
    walked = sum(counts[state] for state in STATES if state.walked)
    passed = counts[State.PASS]
    broken = sum(counts[state] for state in BROKEN)
    parts = [f"{counts[state]:,} {phrase}" for state, phrase in _PHRASES.items() if counts[state]]
    missing = sweep.planned - len(sweep)
    if walked == 0:
        css, headline = "open", "nothing walked"
        sentence = f"None of {_runs(len(sweep))} walked"
    elif passed == walked:
        css, headline = "pass", "pass"
        who = "The one run that walked is" if walked == 1 else f"All {walked:,} runs that walked are"
        sentence = f"{who} within every tolerance"
    else:
        css, headline = "fail", f"{share(passed, walked)} of what walked passes"
        verb = "is" if passed == 1 else "are"
        sentence = f"{passed:,} of the {_runs(walked)} that walked {verb} within every tolerance"
    if broken or missing:
        css = "open" if css == "pass" else css
        headline = "unfinished" if missing else headline if css == "fail" else "not every run has an answer"
    sentence += f"; {', '.join(parts)}." if parts else "."
    if missing:
        sentence += (
            f" {missing:,} of {_runs(sweep.planned)} are still missing: 'ampm sweep --resume' walks them."
        )
    return SweepVerdict(css, headline, sentence)


_PHRASES = {
    State.OUT_OF_TOLERANCE: "out of tolerance",
    State.NOT_MEASURED: "without a verdict",
    State.FELL: "fell",
    State.DIVERGED: "diverged",
    State.INFEASIBLE: "became infeasible",
    State.REFUSED: "refused before walking",
    State.CRASHED: "crashed",
    State.TIMED_OUT: "timed out",
    State.INTERRUPTED: "interrupted",
}


def share(part: int, whole: int) -> str:
    """A percentage that never rounds to all or nothing."""
    if whole == 0 or part in (0, whole):
        return "100\u00a0%" if part and part == whole else "0\u00a0%"
    percent = 100.0 * part / whole
    text = f"{percent:.0f}" if 1.0 <= percent < 99.5 else f"{percent:.1f}"
    if text in ("0.0", "100.0"):
        text = "< 0.1" if percent < 50.0 else "> 99.9"
    return f"{text}\u00a0%"


def counted_states(sweep: SweepTable) -> list[dict[str, object]]:
    """Every state with its count, for tiles; rare ones that no sweep need have only where they occur."""
    always = set(STATES) - {State.NOT_MEASURED, State.INTERRUPTED}
    return [
        {
            "state": state.value,
            "label": state.label,
            "count": count,
            "shown": f"{count:,}",
            "share": share(count, len(sweep)),
        }
        for state, count in sweep.counts.items()
        if count or state in always
    ]


def lost_count(sweep: SweepTable) -> int:
    """Runs that walked, but not to an end that can be measured."""
    return sum(sweep.counts[state] for state in LOST)


def _runs(count: int) -> str:
    return f"{count:,} run{'' if count == 1 else 's'}"
