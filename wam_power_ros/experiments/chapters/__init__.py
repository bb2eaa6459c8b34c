# SPDX-License-Identifier: Apache-2.0
"""The report's chapter of each study."""
