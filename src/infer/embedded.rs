//! Networks through `rten`, which is compiled in: nothing to install, and any host will do.

use super::backend::{Engine, check_length, guarded, no_fixed_shape};
use crate::error::Error;
use rten::{Dimension, Model, ModelOptions, NodeId, OpRegistry, RunOptions, ThreadPool, op_registry};
use rten_tensor::prelude::*;
use rten_tensor::{Tensor, TensorView};
use std::sync::Arc;

/// Version of the engine.
pub const VERSION: &str = "0.27.0";

/// The operators that our networks may use; see `models/README.md`. Each one that is left out makes the library smaller.
fn operators() -> OpRegistry {
    op_registry!(
        Add,
        AveragePool,
        BatchNormalization,
        Cast,
        Clip,
        Concat,
        ConstantOfShape,
        Conv,
        ConvTranspose,
        DepthToSpace,
        Div,
        Elu,
        Erf,
        Exp,
        Expand,
        Flatten,
        Gather,
        Gelu,
        Gemm,
        GlobalAveragePool,
        HardSigmoid,
        HardSwish,
        Identity,
        InstanceNormalization,
        LayerNormalization,
        LeakyRelu,
        MatMul,
        MaxPool,
        Mul,
        Neg,
        Pad,
        Pow,
        ReduceMean,
        Relu,
        Reshape,
        Resize,
        Shape,
        Sigmoid,
        Slice,
        Softmax,
        Softplus,
        Split,
        Sqrt,
        Squeeze,
        Sub,
        Tanh,
        Transpose,
        Unsqueeze
    )
}

/// A network in the embedded engine.
pub struct EmbeddedEngine {
    name: String,
    model: Model,
    pool: Arc<ThreadPool>,
    input: NodeId,
    output: NodeId,
    input_shape: Vec<usize>,
    output_shape: Vec<usize>,
}

impl EmbeddedEngine {
    /// See [`super::backend::Backend::load`].
    pub fn load(pool: &Arc<ThreadPool>, name: &str, bytes: &[u8]) -> Result<Self, Error> {
        let wrong = |reason: String| Error::Model { name: name.into(), reason };
        let mut options = ModelOptions::with_ops(operators());
        options.prepack_weights(true);
        let model = options.load(bytes.to_vec()).map_err(|error| wrong(format!("rten refuses it: {error}")))?;
        let (input, input_shape) = only_tensor(&model, model.input_ids(), "input").map_err(wrong)?;
        let (output, output_shape) = only_tensor(&model, model.output_ids(), "output").map_err(wrong)?;
        let input_shape = input_shape.ok_or_else(|| no_fixed_shape(name, "input"))?;
        let (name, pool) = (name.to_owned(), pool.clone());
        let mut engine = Self { name, model, pool, input, output, input_shape, output_shape: Vec::new() };
        engine.output_shape = match output_shape {
            Some(shape) => shape,
            None => engine.run_once(&vec![0.0; engine.input_shape.iter().product()])?.0,
        };
        Ok(engine)
    }

    /// Shape and values of the output for an input of the right length.
    fn run_once(&self, input: &[f32]) -> Result<(Vec<usize>, Vec<f32>), Error> {
        let failed =
            |reason: String| Error::Backend { backend: "embedded", reason: format!("{}: {reason}", self.name) };
        let options = RunOptions::default().with_thread_pool(Some(self.pool.clone()));
        let tensor = TensorView::from_data(self.input_shape.as_slice(), input);
        let outputs = self.model.run(vec![(self.input, tensor.into())], &[self.output], Some(options));
        let output =
            outputs.map_err(|error| failed(error.to_string()))?.pop().ok_or_else(|| failed("no output".into()))?;
        let tensor: Tensor<f32> = output.try_into().map_err(|_| failed("the output is not 32-bit floats".into()))?;
        Ok((tensor.shape().to_vec(), tensor.into_data()))
    }
}

impl Engine for EmbeddedEngine {
    fn input_shape(&self) -> &[usize] {
        &self.input_shape
    }

    fn output_shape(&self) -> &[usize] {
        &self.output_shape
    }

    fn run(&mut self, input: &[f32]) -> Result<Vec<f32>, Error> {
        check_length(&self.name, "input", &self.input_shape, input.len())?;
        let (_, values) = guarded(&self.name, || self.run_once(input))?;
        check_length(&self.name, "output", &self.output_shape, values.len())?;
        Ok(values)
    }
}

/// Id and shape of the only input or output; no shape if the file leaves a dimension open.
fn only_tensor(model: &Model, ids: &[NodeId], what: &str) -> Result<(NodeId, Option<Vec<usize>>), String> {
    let &[id] = ids else {
        return Err(format!("it has {} {what}s, expected one", ids.len()));
    };
    let fixed = |dimension: Dimension| match dimension {
        Dimension::Fixed(size) => Some(size),
        Dimension::Symbolic(_) => None,
    };
    let shape = model.node_info(id).and_then(|info| info.shape());
    Ok((id, shape.and_then(|shape| shape.into_iter().map(fixed).collect())))
}
