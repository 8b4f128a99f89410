"""Your own greenhouse: the numbers that a grower knows, the parameters of the model that follow from them, and what it can do."""

from glbench.greenhouse.page import Page, read_page
from glbench.greenhouse.parameters import Greenhouse, design

__all__ = ["Greenhouse", "Page", "design", "read_page"]
