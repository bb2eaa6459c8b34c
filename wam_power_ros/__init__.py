# SPDX-License-Identifier: Apache-2.0
"""A torque-controlled arm is taught a skill by hand and gets better at it by practising."""
