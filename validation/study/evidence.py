"""Evidence of a run in one file: what was verified and validated, with what it depends on, and what was not.

Factors and checks are those of ``factors.csv``, after ASME V&V 40 and NASA-STD-7009, in the vocabulary of the
Unit of Assurance (https://uofa.net).
"""

import json
import zipfile
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from ampm.exceptions import InputError
from ampm.parameters import HUMAN
from validation.progress import Progress
from validation.run.replay import replay
from validation.show.cost_table import cost_table
from validation.show.page import render_page
from validation.show.paper import cite_run, digest_of
from validation.store.folders import check_output_file, output_file
from validation.store.saved import SavedRun, digests, load_saved_run
from validation.study.compare.report import NUMBERS, load_comparison
from validation.study.robustness.result import RESULT, load_robustness
from validation.table import Table, own_rows
from validation.trial.files import RunFile


def write_evidence(
    folder: Path, target: Path, studies: Sequence[Path] = (), progress: Progress | None = None
) -> Path:
    """Write page, JSON-LD and small files of a run into a zip file; the run is replayed for it.

    ``studies`` are folders of a robustness study, of a comparison, of judged logs.

    Raises:
        InputError: no run, another suffix, a folder that is not a study, or the file cannot be written.
    """
    if target.suffix != ".zip":
        raise InputError(f"--evidence {target} must end in .zip.")
    check_output_file(target, force=True)
    saved = load_saved_run(folder)
    found = _found(saved) | dict(map(_study, studies))
    if not saved.is_log:
        found["replay"] = f"replay: {replay(folder, progress=progress)}"
    factors = own_rows("study/factors.csv")
    for row in factors:
        checks = row["checks"].split()
        said = [found.get(check, f"{check}: not done") for check in checks]
        row["found"] = "; ".join(said) if found.keys() & set(checks) else ""
    linked = _linked(saved, factors)
    names = ("factor", "standard", "criterion", "found")
    assessed = [tuple(row[name] or "NOT ASSESSED" for name in names) for row in factors]
    environment = [(name, str(value)) for name, value in saved.summary["environment"].items()]
    page = render_page(
        "evidence.html.j2",
        f"Evidence: {saved.title}",
        styles=["report.css"],
        use=linked["hasContextOfUse"]["intendedUse"],
        envelope=_envelope(saved),
        sentence=saved.sentence,
        tables=[
            Table("Factors of credibility", names, assessed),
            saved.table(),
            cost_table(saved.summary),
            Table("Inputs and outputs", ("file", "sha256"), list(digests(folder, saved.summary).items())),
            Table("Environment", ("", ""), environment),
        ],
        citation=cite_run(saved),
    )
    with output_file(target) as work, zipfile.ZipFile(work, "w", zipfile.ZIP_DEFLATED) as bundle:
        bundle.writestr("evidence.html", page)
        bundle.writestr("evidence.jsonld", json.dumps(linked, indent=1))
        for path in sorted(folder / name for name in RunFile):
            if path.is_file() and path.suffix not in (".parquet", ".rrd"):
                bundle.write(path, path.name)
    return target


def _found(saved: SavedRun) -> dict[str, str]:
    """What the run's own checks found, by the names of ``factors.csv``."""
    summary, run = saved.summary, saved.parameters
    known, environment, solver = summary.get("uncertainty"), summary["environment"], summary["solver"]
    checks = [item["pass"] for item in summary["metrics"].values() if item["kind"] == "instrument"]
    judged = [item for item in checks if item is not None]
    changed = ", with changes" if environment["modified"] else ""
    said = {
        "software": f"version {environment['versions']['ampm']}, commit {environment['revision']}{changed}"
    }
    said["inputs"] = f"body {run.body.source}, {saved.record.mass:.4g} kg, friction {run.contact.friction:g}"
    if judged:
        said["equations"] = f"{sum(judged)} of {len(judged)} checks of plan and measurement met"
    if solver["ticks"]:
        said["solver"] = f"{solver['unsolved']} of {solver['ticks']} QPs unsolved"
    if run.body.source == HUMAN:
        said["pedigree"] = "masses by published tables; the contact's stiffness was chosen on the presets"
    if known:
        said["convergence"] = f"study of {known['gait']}, {known['steps']} steps a level: metrics with ±"
    return said


def _study(folder: Path) -> tuple[str, str]:
    """Name of a check, and what the folder of a study found."""
    if (folder / RESULT).is_file():
        return "robustness", load_robustness(folder).title
    if (folder / NUMBERS).is_file():
        comparison = load_comparison(folder)
        engines = {side.run.parameters.simulation.engine for side in comparison.sides}
        return "engine" if len(engines) > 1 else "comparison", comparison.sentence
    saved = load_saved_run(folder)
    if not saved.is_log:
        raise InputError(f"--study {folder} is a walk; give a robustness study, a comparison, or a log.")
    return "log", saved.sentence


def _envelope(saved: SavedRun) -> str:
    """What was walked, beyond which the run says nothing."""
    steps, friction = saved.record.outcome.steps_completed, saved.parameters.contact.friction
    return f"{steps} steps of {saved.title}, friction {friction:g}, profile {saved.summary['profile']}."


def _linked(saved: SavedRun, rows: Sequence[Mapping[str, str]]) -> dict[str, Any]:
    """The evidence as JSON-LD: ``evidence.jsonld`` with what is of this run."""
    summary, text = saved.summary, files("validation").joinpath("study/evidence.jsonld").read_text("utf-8")
    linked: dict[str, Any] = json.loads(text.replace("DIGEST", digest_of(saved)))
    time = {"@value": summary["environment"]["time"], "@type": "http://www.w3.org/2001/XMLSchema#dateTime"}
    linked |= {"schema:name": saved.title, "prov:generatedAtTime": time}
    linked["bindsRequirement"] = {"@id": f"urn:ampm:profile:{summary['profile']}"}
    linked["hasContextOfUse"] |= {"schema:name": saved.title, "hasOperatingEnvelope": _envelope(saved)}
    if "uncertainty" in summary:
        linked["hasValidationResult"]["hasUncertaintyQuantification"] = True
    rationale = f"The trial: {summary['verdict']}. {summary['reason']}"
    linked["hasDecisionRecord"] |= {"rationale": rationale, "role": summary["profile"], "decidedAt": time}
    linked["hasCredibilityFactor"] = [
        {
            "@type": "CredibilityFactor",
            "factorType": row["factor"],
            "factorStandard": row["standard"],
            "assessmentPhase": row["phase"],
            "factorStatus": "assessed" if row["found"] else "not-assessed",
            "acceptanceCriteria": row["criterion"],
            "rationale": row["found"] or "not done",
        }
        for row in rows
    ]
    return linked
