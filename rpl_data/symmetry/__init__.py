"""Symmetries of an object, found from its dense model: motions that bring shape and print onto themselves."""

from rpl_data.symmetry.find import find_symmetry

__all__ = ["find_symmetry"]
