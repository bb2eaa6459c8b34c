# SPDX-License-Identifier: Apache-2.0
"""What the studies compare with and no session needs: learners, and models that screen samples."""
