# SPDX-License-Identifier: Apache-2.0
"""`python -m wam_power_ros.cli`: the same as `wam-power`."""

import sys

from wam_power_ros.cli.main import main

sys.exit(main())
