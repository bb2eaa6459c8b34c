# SPDX-License-Identifier: Apache-2.0
"""The simulated arm in one process: environment, images, and the film of a session's report."""
