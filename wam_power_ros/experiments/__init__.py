# SPDX-License-Identifier: Apache-2.0
"""In-process studies: learning, control and simulation in one process, without DDS."""
