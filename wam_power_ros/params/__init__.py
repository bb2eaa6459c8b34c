# SPDX-License-Identifier: Apache-2.0
"""YAML files to parameters: set-ups that override each other, and checked parameter classes."""
