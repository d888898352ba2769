"""Motions by which a robot calibrates its own feet: rehearsed in simulation, chosen by what they bring."""
