//! Method `mask-raster`: masks of triangles from tables, for all pixels that a triangle may occlude. Approximate.

use super::{Answers, Engine, Report, Sky, one_mesh};
use crate::{AoMethod, Occluders, QueryError, Structure};
use umbrage_aomask::{MaskOptions, MaskTables, Outputs, RasterCall, RasterLevel, RasterView};
use umbrage_geom::TriangleMesh;

pub(super) struct MaskRaster<'a> {
    mesh: &'a TriangleMesh,
    tables: Box<MaskTables>,
    options: MaskOptions,
}

impl<'a> MaskRaster<'a> {
    pub(super) fn build(occluders: &'a Occluders, sky: &Sky) -> Result<Self, QueryError> {
        let (_, mesh) = one_mesh(AoMethod::MaskRaster.name(), occluders.flat_opaque())?;
        let (pattern, options) = sky.masks_of_tables()?;
        let tables = occluders.mask_tables(pattern)?;
        Ok(Self { mesh, tables, options })
    }
}

impl Engine for MaskRaster<'_> {
    fn name(&self) -> &'static str {
        AoMethod::MaskRaster.name()
    }

    fn structures(&self) -> &'static [Structure] {
        &[Structure::MaskTables]
    }

    fn answers(&self) -> Answers {
        Answers::Images
    }

    fn image(
        &self,
        view: &RasterView<'_>,
        seed: u32,
        outputs: Outputs<'_>,
        progress: Report<'_>,
    ) -> Result<(), QueryError> {
        let level = RasterLevel::exact(&self.mesh.positions, &self.mesh.triangles);
        let options = self.options.with_seed(seed);
        RasterCall::new(&self.tables, &[level], view).with_options(options).run(outputs, progress)?;
        Ok(())
    }
}
