"""Scenes of two or three nodes in which all happens that happens to a robot: gaits, dampers, contact, friction."""

import numpy as np

from jaxgrity import ConeFriction, ExactGround, Gait, Members, PenaltyGround, Scene, SmoothFriction, Structure

NODES = np.array([[0.0, 0, 0], [0.8, 0, 0.6], [0.5, 0.6, 0.2]])


def swept(stiff: bool = True, ground: bool = True) -> Scene:
    """A strut and a node that two damped cables hold; the strut's length changes from the start."""
    cables = Members(((0, 2), (1, 2)), [300.0, 300.0], [0.6, 0.6], damping=[5.0, 5.0])
    struts = Members(((0, 1),), None if stiff else [5e3], [1.0], damping=None if stiff else [10.0])
    contact = (ExactGround(), ConeFriction(0.5)) if stiff else (PenaltyGround(5e3, 1.0), SmoothFriction(0.5, 0.01))
    return Scene(
        Structure(NODES, [1.0, 2.0, 0.5], struts, cables),
        gravity=9.81,
        node_damping=[0.1, 0.2, 0.3],
        ground=contact[0] if ground else None,
        friction=contact[1] if ground else None,
        gait=Gait((0,), [0.3], [0.2], [2.0], start=0.0, ramp=0.1),
    )


def class_2() -> Scene:
    """Two rigid struts that share a node, above the ground, which both are solved together with."""
    lengths = np.linalg.norm(NODES[[0, 1]] - NODES[[1, 2]], axis=1)
    struts = Members(((0, 1), (1, 2)), None, lengths)
    cables = Members(((0, 2),), [300.0], [0.5], damping=[5.0])
    return Scene(
        Structure(NODES, [1.0, 2.0, 0.5], struts, cables),
        gravity=9.81,
        ground=ExactGround(restitution=0.5),
        friction=ConeFriction(0.5),
        gait=Gait((0,), [0.3], [0.2], [2.0], start=0.0, ramp=0.1),
    )
