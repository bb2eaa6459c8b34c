# SPDX-License-Identifier: Apache-2.0
"""YAML files to parameters: set-ups laid over each other, checked parameter classes."""
