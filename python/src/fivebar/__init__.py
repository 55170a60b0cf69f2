"""Planar five-bar mechanism: kinematics and workspace of the machines that the unit FiveBar.fmu simulates."""

from importlib.metadata import version

__version__ = version("fivebar")
