//! Method `mask-table`: masks of triangles from tables. Approximate.

use super::{Answers, Engine, Report, Sky, one_mesh};
use crate::{AoMethod, Occluders, QueryError, Structure};
use umbrage_accel::Bvh;
use umbrage_aomask::{MaskOptions, MaskTables, Outputs, Pattern, Receiver, exact::adaptive::Spent};

pub(super) struct MaskTable<'a> {
    bvh: &'a Bvh,
    tables: Box<MaskTables>,
    options: MaskOptions,
}

impl<'a> MaskTable<'a> {
    pub(super) fn build(occluders: &'a Occluders, sky: &Sky) -> Result<Self, QueryError> {
        let bvh = one_mesh(AoMethod::MaskTable.name(), occluders.flat())?;
        let (pattern, options) = sky.masks_of_tables()?;
        let tables = occluders.mask_tables(pattern)?;
        Ok(Self { bvh, tables, options })
    }
}

impl Engine for MaskTable<'_> {
    fn name(&self) -> &'static str {
        AoMethod::MaskTable.name()
    }

    fn structures(&self) -> &'static [Structure] {
        &[Structure::Bvh, Structure::MaskTables]
    }

    fn answers(&self) -> Answers {
        Answers::Receivers
    }

    fn pattern(&self) -> Option<&Pattern> {
        Some(self.tables.pattern())
    }

    fn sky(
        &self,
        receivers: &[Receiver],
        outputs: Outputs<'_>,
        progress: Report<'_>,
    ) -> Result<Spent, QueryError> {
        self.tables.answer(self.bvh, receivers, &self.options, outputs, progress)?;
        Ok(Spent::uniform(self.tables.pattern().len() as u32, receivers.len() as u64))
    }
}
