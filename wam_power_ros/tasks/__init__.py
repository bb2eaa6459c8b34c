# SPDX-License-Identifier: Apache-2.0
"""What a skill is: return, success, parametrization and model of each task. Pure."""
