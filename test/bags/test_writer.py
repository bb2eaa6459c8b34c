# SPDX-License-Identifier: Apache-2.0
"""Bags being written: unfinished until closed, then whole, with the metadata of Jazzy."""

import json
from pathlib import Path

import pytest
import yaml
from bag_samples import NAMES, QOS, START, demonstration, joint_state, random_q
from mcap.reader import make_reader

from wam_power_ros.bags import layout
from wam_power_ros.bags.layout import unfinished
from wam_power_ros.bags.reader import read_demonstration
from wam_power_ros.bags.writer import BagWriter

# of `ros2 topic info -v /joint_states` on Jazzy
JOINT_STATE_HASH = "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"


def test_metadata_and_channels_are_those_of_jazzy(tmp_path: Path) -> None:
    path = demonstration(tmp_path / "demo", random_q(5))
    info = yaml.safe_load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert (info["version"], info["storage_identifier"]) == (9, "mcap")
    assert info["ros_distro"] == "jazzy"
    assert info["relative_file_paths"] == ["demo.mcap"]
    assert json.loads(info["custom_data"]["joint_names"]) == list(NAMES)
    topics = {item["topic_metadata"]["name"]: item for item in info["topics_with_message_count"]}
    assert topics["/joint_states"]["message_count"] == 10
    latched = topics["/robot_description"]["topic_metadata"]
    assert latched["offered_qos_profiles"][0]["durability"] == "transient_local"
    assert latched["offered_qos_profiles"][0]["reliability"] == "reliable"
    assert latched["offered_qos_profiles"][0]["lifespan"] == {"sec": 9223372036, "nsec": 854775807}
    for item in topics.values():
        assert item["topic_metadata"]["type_description_hash"].startswith("RIHS01_")
    with (path / "demo.mcap").open("rb") as file:
        reader = make_reader(file)
        channels = list(reader.get_summary().channels.values())
        (metadata,) = reader.iter_metadata()
    hashes = {each.topic: each.metadata["topic_type_hash"] for each in channels}
    assert hashes["/joint_states"] == JOINT_STATE_HASH
    assert all(each.metadata["offered_qos_profiles"] for each in channels)
    assert "ros_distro: jazzy" in metadata.metadata["serialized_metadata"]


def test_a_bag_under_way_is_recognisable_and_appears_whole(tmp_path: Path) -> None:
    path = tmp_path / "demo"
    writer = BagWriter(path)
    assert not path.exists()
    assert unfinished(path).is_dir()
    with pytest.raises(FileExistsError):
        BagWriter(path)
    with pytest.raises(ValueError, match="never closed"):
        read_demonstration(path, NAMES)
    writer.add("/joint_states", layout.JOINT_STATE, QOS)
    writer.write("/joint_states", START, joint_state(START, NAMES, [1.0, 2.0, 3.0]))
    writer.close({})
    assert not unfinished(path).exists()
    assert read_demonstration(path, NAMES)[1].tolist() == [[1.0, 2.0, 3.0]]
    with pytest.raises(FileExistsError):
        BagWriter(path)
