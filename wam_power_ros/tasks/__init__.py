# SPDX-License-Identifier: Apache-2.0
"""Tasks: return, success criterion, parametrization and model of each skill. Pure."""
