# SPDX-License-Identifier: Apache-2.0
"""The page of `wam-power view`: an arm and its session in a browser."""
