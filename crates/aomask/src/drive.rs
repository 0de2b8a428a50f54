//! Running an engine over slices of receivers: order, threads, progress.
//!
//! Not here: what is made of the answers (`gather.rs`).

use crate::{
    MaskError, MaskOptions, Outputs, Pattern, Receiver,
    gather::{Answers, Gathered, OutputRequest},
};
use umbrage_geom::{Progress, morton};

/// Receivers that a thread takes at a time, neighbours in Morton order.
const BLOCK: usize = 64;

/// Finds what the rays of receivers meet.
pub(crate) trait Engine: Sync {
    /// What a thread keeps between blocks.
    type Scratch: Send;

    fn scratch(&self) -> Self::Scratch;

    /// Answers a block of receivers; the masks are of the right length and may hold anything.
    fn answer(&self, receivers: &[Receiver], answers: &mut Answers, scratch: &mut Self::Scratch);
}

/// Answers all receivers.
///
/// # Errors
/// As the public calls that lead here; the outputs are untouched then.
pub(crate) fn run<E: Engine>(
    engine: &E,
    pattern: &Pattern,
    options: &MaskOptions,
    receivers: &[Receiver],
    mut outputs: Outputs<'_>,
    progress: &mut (dyn FnMut(f32) -> bool + Send),
) -> Result<(), MaskError> {
    options.validate(pattern)?;
    outputs.validate(receivers.len(), pattern.words())?;
    let wanted = OutputRequest::new(&outputs);
    let points: Vec<[f32; 3]> = receivers.iter().map(|receiver| receiver.point().to_array()).collect();
    let order = morton::order(&points);
    let progress = Progress::new(order.len().div_ceil(BLOCK) as u64, progress);
    let job = |(scratch, answers, block): &mut (E::Scratch, Answers, Vec<Receiver>), order: &[u32]| {
        progress.check()?;
        block.clear();
        block.extend(order.iter().map(|&i| receivers[i as usize]));
        answers.resize(pattern, block.len());
        engine.answer(block, answers, scratch);
        let gathered = wanted.gather(pattern, block.iter().map(Some), answers);
        progress.advance(1)?;
        Ok::<Gathered, MaskError>(gathered)
    };
    let room = || (engine.scratch(), Answers::default(), Vec::with_capacity(BLOCK));
    #[cfg(feature = "rayon")]
    let blocks = {
        use rayon::prelude::*;
        order.par_chunks(BLOCK).map_init(room, job).collect::<Result<Vec<_>, MaskError>>()?
    };
    #[cfg(not(feature = "rayon"))]
    let blocks = {
        let mut room = room();
        order.chunks(BLOCK).map(|block| job(&mut room, block)).collect::<Result<Vec<_>, MaskError>>()?
    };
    progress.finish()?;
    for (gathered, order) in blocks.iter().zip(order.chunks(BLOCK)) {
        gathered.write(&mut outputs, order.iter().map(|&i| i as usize));
    }
    Ok(())
}
