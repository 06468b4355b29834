"""The paper's figures, drawn again from data: the plan, the body's motion, and the walk in physics."""

from validation.paper.figures.make import FIGURES, make_figures

__all__ = ["FIGURES", "make_figures"]
