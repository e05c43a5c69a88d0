"""A head to have made: housing, masks, drawings, bill of materials and assembly page, from a scene.

``python3 -m slitpose.export SCENE --output DIR``, or ``slitpose scene export``. Needs Python 3.11 and the extra ``cad``:
``pip install 'slitpose[cad]'``. Nothing of it has been built or measured. Lengths are millimetres here, as in drawings.
"""
