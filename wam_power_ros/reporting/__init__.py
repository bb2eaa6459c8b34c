# SPDX-License-Identifier: Apache-2.0
"""Terminal display, HTML pages and figures."""
