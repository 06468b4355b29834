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

from jinja2 import Template

from ampm.exceptions import InputError
from ampm.parameters import HUMAN
from validation.progress import Progress
from validation.run.replay import replay
from validation.show.cost_table import cost_table
from validation.show.page import render_page
from validation.show.paper import cite_run, digest_of
from validation.store.folders import check_output_file, output_file
from validation.store.saved import SavedRun, digests, load_saved_run
from validation.study.compare.report import is_comparison, load_comparison
from validation.study.robustness.study import ROBUSTNESS_FILE, gait_and_body, load_robustness
from validation.table import Table, package_rows
from validation.trial.files import RunFile


def write_evidence(
    folder: Path, target: Path, studies: Sequence[Path], progress: Progress, *, force: bool = False
) -> Path:
    """Write page, JSON-LD and small files of a walk into a zip file; the walk is replayed for it.

    ``studies`` are folders of a robustness study, of a comparison of engines, of judged logs, for its gait.
    Raises :class:`InputError` for no walk, another suffix, no such study, or a file that cannot be written.
    """
    if target.suffix != ".zip":
        raise InputError(f"--evidence {target} must end in .zip.")
    check_output_file(target, force=force)
    saved = load_saved_run(folder)
    if saved.is_log:
        raise InputError(f"{folder} is a log; give a walk of its plan, with --study {folder}.")
    found = _found(saved)
    for name, result in (_study(study, saved) for study in studies):
        found[name] = f"{found[name]}; {result}" if name in found else result
    found["replay"] = f"replay: {replay(folder, progress=progress)}"
    factors = package_rows("study/factors.csv")
    for row in factors:
        checks = row["checks"].split()
        said = [found.get(check, f"{check}: not done") for check in checks]
        row["found"] = "; ".join(said) if found.keys() & set(checks) else ""
    linked = _linked(saved, factors)
    names = ("factor", "standard", "criterion", "found")
    assessed = [tuple(row[name] or "NOT ASSESSED" for name in names) for row in factors]
    facts = saved.summary["environment"]
    versions = ", ".join(f"{name} {version}" for name, version in facts["versions"].items())
    facts = facts | {"versions": versions, "memory": f"{facts['memory']} GB"}
    page = render_page(
        "evidence.html.j2",
        f"Evidence: {saved.title}",
        use=linked["hasContextOfUse"]["intendedUse"],
        envelope=linked["hasContextOfUse"]["hasOperatingEnvelope"],
        sentence=saved.sentence,
        tables=[
            Table("Factors of credibility", names, assessed),
            saved.table(),
            cost_table(saved.summary),
            Table("Inputs and outputs", ("file", "sha256"), list(digests(folder, saved.summary).items())),
            Table("Environment", ("", ""), [(name, str(value)) for name, value in facts.items()]),
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
        "software": f"version {environment['versions']['ampm']}, commit {environment['revision']}{changed}",
        "inputs": f"body {run.body.source}, {saved.record.mass:.4g} kg, friction {run.contact.friction:g}",
        "equations": f"{sum(judged)} of {len(judged)} checks of plan and measurement met",
    }
    if solver["unsolved"] is not None:
        said["solver"] = f"{solver['unsolved']} of {solver['ticks']} QPs unsolved"
    if run.body.source == HUMAN:
        said["pedigree"] = "masses by published tables; the contact's stiffness was chosen on the presets"
    if known:
        said["convergence"] = f"study of {known['gait']}, {known['steps']} steps a level: metrics with ±"
        said["contact"] = f"contact laws varied: {summary['verdict']}"
    return said


def _study(folder: Path, saved: SavedRun) -> tuple[str, str]:
    """Name of a check, and what the folder of a study of a walk found."""
    run, runs, fits = saved.parameters, list[SavedRun](), False
    walk = saved.title, run.controller.name, gait_and_body(run)
    if (folder / ROBUSTNESS_FILE).is_file():
        study = load_robustness(folder)
        name, found, fits = "robustness", study.title, (study.gait, study.controller, study.walked) == walk
    elif is_comparison(folder):
        runs = [side.run for side in load_comparison(folder).sides]
        verdicts = {side.parameters.simulation.engine: side.summary["verdict"] for side in runs}
        name, found = "engine", ", ".join(f"{engine}: {verdict}" for engine, verdict in verdicts.items())
        fits = len(verdicts) > 1
    elif (folder / RunFile.RUN).is_file():
        runs = [load_saved_run(folder)]
        name, found, fits = "log", runs[0].sentence, runs[0].is_log
    if not fits or any(gait_and_body(other.parameters) != walk[-1] for other in runs):
        raise InputError(
            f"--study {folder} is neither a robustness study nor a comparison of engines nor a log, of the "
            f"gait and body of {saved.title}; give another study."
        )
    return name, found


def _linked(saved: SavedRun, factors: Sequence[Mapping[str, str]]) -> dict[str, Any]:
    """The evidence as JSON-LD: the template ``evidence.jsonld``, filled in."""
    template = Template(files("validation").joinpath("study/evidence.jsonld").read_text("utf-8"))
    return dict(json.loads(template.render(saved=saved, digest=digest_of(saved), factors=factors)))
