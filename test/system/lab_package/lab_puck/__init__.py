# SPDX-License-Identifier: Apache-2.0
"""A laboratory's own task: carry a ball in a cup to a goal, without letting it roll."""
