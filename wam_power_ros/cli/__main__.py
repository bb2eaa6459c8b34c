# SPDX-License-Identifier: Apache-2.0
"""`python -m wam_power_ros.cli`: the same as `wam-power`."""

from wam_power_ros.entry import wam_power

raise SystemExit(wam_power())
