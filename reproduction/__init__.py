# SPDX-License-Identifier: Apache-2.0
"""The paper's experiments from scratch, and one report of their results: `make reproduce`."""
