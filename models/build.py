"""The body of a run: the human, scaled from its file, or another one, read from its description."""

from ampm.parameters import HUMAN, RunParameters
from models.human import build_human
from models.load import Writer
from models.scene import BodyModel
from models.source import body_path, compiled_source, read_body_file, source_path
from models.tree import Tree


def build_body(run: RunParameters) -> BodyModel:
    """Build the body that ``body.source`` of a run names, with its contact, time step and integrator.

    Raises InputError if there is no such body, or its description or source is not usable.
    """
    if run.body.source == HUMAN:
        return build_human(run)
    path = body_path(run.body.source)
    file = read_body_file(path)
    source = source_path(file.source, path.parent)
    model, speeds = compiled_source(source, balance=file.balance_inertia)
    return Writer(Tree(file, model, speeds)).write(run)
