# SPDX-License-Identifier: Apache-2.0
"""`python -m reproduction`, with one thread for linear algebra, see `wam_power_ros.entry`."""

import sys

from wam_power_ros import entry

if __name__ == "__main__":
    sys.exit(entry.start("reproduction.report", entry.INTERRUPTED))
