# SPDX-License-Identifier: Apache-2.0
"""A laboratory's own task: push a puck, by a tool of its own, so that it stops at a mark."""
