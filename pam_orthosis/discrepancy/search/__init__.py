# SPDX-License-Identifier: Apache-2.0
"""Effects are added one by one while recordings say so, and dropped again."""
