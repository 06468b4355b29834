"""The body of a run: the human, built from tables, or another one, read from its description."""

from ampm.parameters import HUMAN, BodyParameters, ContactParameters, SimulationParameters
from models import human
from models.load import load_body
from models.scene import BodyModel
from models.source import body_path, read_body_file


def build_body(
    body: BodyParameters, contact: ContactParameters, simulation: SimulationParameters
) -> BodyModel:
    """Build the body that ``body.source`` names; see :func:`models.human.build`.

    Raises:
        InputError: there is no such body, or its description or source is not usable.
    """
    if body.source == HUMAN:
        return human.build(body, contact, simulation)
    path = body_path(body.source)
    return load_body(read_body_file(path), path.parent, contact, simulation)
