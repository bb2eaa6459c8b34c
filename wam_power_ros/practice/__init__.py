# SPDX-License-Identifier: Apache-2.0
"""Course of a session: selection of the next policy, and the session log on disk."""
