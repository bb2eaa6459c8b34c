# SPDX-License-Identifier: Apache-2.0
"""What each node may do by the shipped SROS2 policy."""

from __future__ import annotations

from xml.etree import ElementTree

from conftest import ROOT

Rights = dict[tuple[str, str], set[str]]  # names by kind and right, such as ("topic", "publish")
RIGHTS: dict[str, Rights] = {}
for profile in ElementTree.parse(ROOT / "security/policy.xml").iter("profile"):
    rights: Rights = {
        (kind, right): {each.text or "" for each in group}
        for kind in ("topic", "service", "action")
        for group in profile.iter(f"{kind}s")
        for right in group.attrib
    }
    RIGHTS[profile.attrib["node"]] = rights
