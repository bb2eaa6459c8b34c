# SPDX-License-Identifier: Apache-2.0
"""Ball-in-a-cup: swing a ball on a string up and catch it [Kober2011]."""
