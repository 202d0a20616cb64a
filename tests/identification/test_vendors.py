"""Payloads in the words of controllers: read back with other code, and as the vendors read them."""

from __future__ import annotations

import ast
import json
import re
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from testbed.applications.payload.payload import PayloadEstimate
from testbed.applications.payload.vendors import VENDORS, FlangePayload, at_flange
from testbed.core.base.arrays import Array
from testbed.core.base.errors import SettingsError
from testbed.core.robot.inertia import NOTHING
from testbed.core.robot.repair import Link
from testbed.core.robot.tree import Placement
from tests.helpers.refusals import refuses
from tests.helpers.runs import robot

TURN = Rotation.from_euler("xyz", [0.3, -0.8, 2.0]).as_matrix()
PLACE = np.array([0.02, -0.05, 0.11])
FLANGE = Link("tool0", 2, "forearm", "forearm", TURN, PLACE, NOTHING)


def points() -> tuple[Array, Array]:
    """A payload as masses and places in the frame of its link."""
    rng = np.random.default_rng(8)
    return rng.uniform(0.05, 0.4, 6), rng.normal(scale=0.1, size=(6, 3))


def central(mass: Array, place: Array) -> tuple[float, Array, Array]:
    """Mass, centre, and inertia about it."""
    centre = mass @ place / mass.sum()
    arm = place - centre
    tensor = np.einsum("k,kij->ij", mass, (arm**2).sum(1)[:, None, None] * np.eye(3))
    return float(mass.sum()), centre, tensor - np.einsum("k,ki,kj->ij", mass, arm, arm)


def estimate() -> PayloadEstimate:
    """Of those points, about their link's frame."""
    mass, place = points()
    tensor = np.einsum("k,kij->ij", mass, (place**2).sum(1)[:, None, None] * np.eye(3))
    tensor = tensor - np.einsum("k,ki,kj->ij", mass, place, place)
    ten = [mass.sum(), *(mass @ place), *(tensor[a, b] for a, b in ((0, 0), (0, 1), (1, 1)))]
    ten += [tensor[a, b] for a, b in ((0, 2), (1, 2), (2, 2))]
    rng = np.random.default_rng(2)
    root = 1e-4 * rng.normal(size=(10, 10))
    covariance = root @ root.T
    sigma = np.sqrt(np.diagonal(covariance))
    known = (True,) * 10
    values = np.array(ten)
    return PayloadEstimate("elbow", known, values, sigma, covariance, 10, 0.5)


def read_back(vendor: str, text: str) -> tuple[float, Array, Array]:
    """Mass [kg], centre [m] and inertia about it [kg m^2], by the vendor's definition."""
    number = r"(-?[\d.]+(?:e-?\d+)?)"
    if vendor == "ur":
        call = ast.parse(text.splitlines()[-1], mode="eval").body
        assert isinstance(call, ast.Call)
        mass, centre, (xx, yy, zz, xy, xz, yz) = map(ast.literal_eval, call.args)
        return mass, np.array(centre), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if vendor == "franka":
        said = json.loads(text)
        inertia = np.array(said["inertia"]).reshape(3, 3, order="F")
        return said["mass"], np.array(said["centerOfMass"]), inertia
    found = re.search(r"\{M (\S+),CM \{(.*?)\},J \{(.*?)\}\}", text)
    assert found is not None
    frame, moments = (
        [float(x) for x in re.findall(rf"[XYZABC] {number}", part)] for part in found.groups()[1:]
    )
    turn = Rotation.from_euler("ZYX", frame[3:], degrees=True).as_matrix()
    return float(found[1]), np.array(frame[:3]) / 1000, turn @ np.diag(moments) @ turn.T


def test_every_vendor_reads_the_payload_at_the_flange() -> None:
    """Wrong end-effector inertias cost a Franka a fifth of its tracking; also beyond a sensor."""
    turn = Rotation.from_euler("xyz", [1.0, 0.2, -0.5]).as_matrix()
    sensor = Placement(np.array([0.1, 0.0, 0.2]), turn, "wrist", 2)
    felt = replace(robot("puma"), sensor=sensor)
    mass, place = points()
    moved = place @ turn.T + sensor.position
    for tree, link, seen in (
        (robot("puma"), None, place),
        (robot("puma"), FLANGE, (place - PLACE) @ TURN),
        (felt, None, place),
        (felt, FLANGE, (moved - PLACE) @ TURN),
    ):
        load, expected = at_flange(estimate(), tree, link), central(mass, seen)
        assert load.frame == ("tool0" if link else "wrist" if tree is felt else "link3")
        for vendor, text in VENDORS.items():
            read = read_back(vendor, text(load))
            for k in range(3):
                np.testing.assert_allclose(read[k], expected[k], rtol=1e-12, atol=1e-14)


def test_sigma_is_the_spread_of_what_is_written() -> None:
    found, tree = estimate(), robot("puma")
    load = at_flange(found, tree, FLANGE)
    rng, rows = np.random.default_rng(1), []
    for values in rng.multivariate_normal(found.values, found.covariance, 500):
        own = at_flange(replace(found, values=values), tree, FLANGE)
        rows.append([own.inertia.mass, *own.inertia.com, *own.six])
    np.testing.assert_allclose(np.std(rows, axis=0), load.sigma, rtol=0.12)


def test_what_no_controller_should_get_is_refused() -> None:
    found, tree = estimate(), robot("puma")
    flat = replace(found, values=found.values - np.eye(10)[4] * 1.0)
    with refuses(SettingsError, "payload"):
        at_flange(flat, tree)
    with refuses(SettingsError, "Iyz"):
        at_flange(replace(found, identifiable=(*[True] * 8, False, True)), tree)
    with refuses(SettingsError, "tool0"):
        at_flange(found, tree, replace(FLANGE, body=1))


def test_words_of_the_vendors_own_examples() -> None:
    """Names and order as in Franka's file for a Robotiq gripper and KUKA's $config.dat."""
    load = at_flange(estimate(), robot("puma"))
    assert isinstance(load, FlangePayload)
    assert {"mass", "centerOfMass", "inertia"} < set(json.loads(VENDORS["franka"](load)))
    last = VENDORS["kuka"](load).splitlines()[-1]
    assert re.sub(r"-?[\d.]+(?:e-?\d+)?", "#", last) == (
        "LOAD_DATA[#]={M #,CM {X #,Y #,Z #,A #,B #,C #},J {X #,Y #,Z #}}"
    )
