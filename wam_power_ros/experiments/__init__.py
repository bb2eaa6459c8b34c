# SPDX-License-Identifier: Apache-2.0
"""In-process studies: the core and the stand-in's world in one process, no DDS."""
