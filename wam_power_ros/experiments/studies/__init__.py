# SPDX-License-Identifier: Apache-2.0
"""The runs of each study."""
