# SPDX-License-Identifier: Apache-2.0
"""The page of `wam-power view`: an arm, its movements and a session in a browser."""
