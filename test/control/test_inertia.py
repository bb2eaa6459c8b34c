# SPDX-License-Identifier: Apache-2.0
"""An arm whose links are no physical bodies is refused by the names of these links."""

import re
from xml.etree import ElementTree

import pytest

from wam_power_ros.control.arm import Arm
from wam_power_ros.params.resources import share

WAM, COBOT = (share(f"urdf/{name}.urdf").read_text() for name in ("wam7", "cobot7"))
NAMES = [f"wam_j{i}" for i in range(1, 8)]
COBOT_NAMES = [f"cobot_joint{i}" for i in range(1, 8)]
COBOT_LINKS = [f"cobot_link{i}" for i in range(1, 8)]


def changed(link: str, **values: str | None) -> str:
    """The invented arm with other values of a link's `<inertial>`; None deletes an attribute."""
    tree = ElementTree.fromstring(COBOT)
    inertial = tree.find(f"./link[@name='{link}']/inertial")
    for name, value in values.items():
        where = {"mass": "mass", "xyz": "origin"}.get(name, "inertia")
        element, key = inertial.find(where), "value" if name == "mass" else name
        if value is None:
            del element.attrib[key]
        else:
            element.set(key, value)
    return ElementTree.tostring(tree, encoding="unicode")


def without_inertials(urdf: str, links: str = ".*") -> str:
    """The URDF without `<inertial>` in the links whose names match."""
    tree = ElementTree.fromstring(urdf)
    for link in tree.iterfind("./link"):
        if re.fullmatch(links, link.get("name")) and link.find("inertial") is not None:
            link.remove(link.find("inertial"))
    return ElementTree.tostring(tree, encoding="unicode")


def cobot(urdf: str, names: list[str] = COBOT_NAMES) -> Arm:
    return Arm(urdf, names, "cobot_pan", guarded=())


def refusal(urdf: str) -> str:
    with pytest.raises(ValueError) as refused:
        cobot(urdf)
    return str(refused.value)


@pytest.mark.requirement("S-111")
def test_links_that_move_without_mass_are_named() -> None:
    text = refusal(without_inertials(COBOT))
    assert f"links {[*COBOT_LINKS, 'cobot_pan']} move without mass" in text
    assert "cobot_base" not in text
    text = refusal(without_inertials(COBOT, "cobot_link[67]|cobot_pan"))
    assert "links ['cobot_link6', 'cobot_link7', 'cobot_pan'] move without mass" in text


@pytest.mark.requirement("S-111")
def test_a_link_without_mass_that_carries_others_or_is_fixed_to_another_is_no_reason() -> None:
    for links in ("cobot_base", "cobot_link6", "cobot_pan", "cobot_link[135]"):
        cobot(without_inertials(COBOT, links))
    Arm(without_inertials(WAM, "pan"), NAMES)


@pytest.mark.requirement("S-111")
def test_a_link_that_does_not_move_is_not_checked() -> None:
    cobot(changed("cobot_base", mass="-1"))
    cobot(changed("cobot_link1", mass="-1"), COBOT_NAMES[1:])
    with pytest.raises(ValueError, match="cobot_link2"):
        cobot(changed("cobot_link2", mass="-1"), COBOT_NAMES[1:])


@pytest.mark.requirement("S-111")
@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"mass": "-2.6"}, "mass -2.6 kg of link 'cobot_link3' must not be negative"),
        ({"mass": "nan"}, "'cobot_link3' must have finite numbers"),
        ({"mass": None}, "'cobot_link3' must have finite numbers"),
        ({"ixx": "inf"}, "'cobot_link3' must have finite numbers"),
        ({"xyz": "0 nan 0"}, "'cobot_link3' must have finite numbers"),
        ({"xyz": "60 30 10"}, "links ['cobot_link3'], which move together, have their centre of"),
        ({"ixx": "-0.01"}, "links ['cobot_link3'], which move together, have the principal mom"),
        ({"izz": "1.0"}, "none may exceed the sum of the others"),
        ({"ixy": "0.5"}, "must not be negative"),
    ],
)
def test_an_inertial_of_no_body_is_refused_with_the_link_and_the_value(
    values: dict[str, str | None], reason: str
) -> None:
    assert reason in refusal(changed("cobot_link3", **values))


def test_an_inertial_without_mass_or_inertia_is_refused_rather_than_left_out() -> None:
    before, name, after = COBOT.partition('<link name="cobot_link3">')
    for part in ("mass", "inertia"):
        text = refusal(before + name + re.sub(f"<{part} [^>]*>", "", after, count=1))
        assert text == "<inertial> of link 'cobot_link3' must have <mass> and <inertia>"


@pytest.mark.requirement("S-111")
def test_a_mass_matrix_that_is_not_positive_definite_names_the_links() -> None:
    # Point masses: the last joint turns about the centre of mass of what it moves.
    points = re.sub(r'(i[xyz]{2})="[^"]*"', r'\1="0"', COBOT)
    points = re.sub(
        r'(<link name="cobot_(?:link7|pan)">\s*<inertial>\s*<origin xyz=")[^"]*',
        r"\g<1>0.1 0 0",
        points,
    )
    text = refusal(points)
    assert "links ['cobot_link7', 'cobot_pan'] turn without inertia" in text
    assert "not positive definite at joint 'cobot_joint7'" in text


@pytest.mark.requirement("S-111")
def test_rounded_and_identified_inertias_of_real_arms_are_accepted() -> None:
    # Link 4 of Franka's FER (0.09 beyond the rule), and a finger (0.62) that is fixed to a hand.
    cobot(changed("cobot_link3", ixx="0.0037", iyy="0.0080", izz="0.0127"))
    cobot(changed("cobot_link3", ixx="0.003", iyy="0.004", izz="0.0099"))
    beyond = changed("cobot_link3", ixx="0.003", iyy="0.004", izz="0.0101")
    assert "cobot_link3" in refusal(beyond)
    cobot(changed("cobot_link3", ixx="-0.000001", iyy="0.002", izz="0.002"))  # a thin rod
    finger = (
        '<link name="finger"><inertial><origin xyz="0 0 0.05"/><mass value="0.036"/><inertia '
        'ixx="1.3e-7" iyy="1.4e-6" izz="4e-6" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="slide" type="prismatic"><parent link="cobot_link7"/><child link="finger"/>'
        '<axis xyz="0 1 0"/><limit lower="0" upper="0.04" effort="9" velocity="1"/></joint></robot>'
    )
    cobot(COBOT.replace("</robot>", finger))
